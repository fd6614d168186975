"""Every error a person can meet, with one sentence that says what, value, limit and what to do next."""

# Why a simulation has failed: the reasons that rows of the lake keep, and how a person reads them.
REASON_WORDS = {
    "arithmetic": "numbers got out of range",
    "crash": "the mesher ended in the middle of its work",
    "deep_penetration": "the finger would go too deep into the object",
    "empty": "the finger's outline gave no mesh",
    "hang": "no answer in time, so its process was ended",
    "indefinite": "the solver found no stable state",
    "inverted_element": "an element of the mesh turned inside out",
    "max_steps": "too many steps, the grasp does not settle",
    "no_convergence": "the solver found no balance of forces",
    "object_outside": "the object is out of the fingers' reach",
    "overlap_at_start": "the object touches the open fingers",
    "time_out": "longer than its time limit",
    "worker_died": "its process died each time, often for want of memory",
}


class FastError(Exception):
    """Root of all expected errors. The command line prints the message and exits with `exit_status`."""

    exit_status = 1


class UsageError(FastError):
    """What the person typed or wrote in a file cannot be used. Nothing was written or moved."""

    exit_status = 2


class ConfigError(UsageError):
    """A config, world or design file has an unusable value or an unknown key."""


class MissingDependencyError(UsageError):
    """A package or program that this command needs is not installed."""


class ReasonedError(FastError):
    """A failure with a short machine-readable `reason`, which is what the lake keeps of it."""

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message, reason)  # both, so that it can be pickled on its way out of a worker
        self.reason = reason

    def __str__(self) -> str:
        return str(self.args[0])


class MeshingFailed(ReasonedError):
    """A mesher gave no usable mesh (`time_out`, `crash`, `empty`, ...)."""


class SimulationFailed(ReasonedError):
    """A grasp simulation ended without a result (`time_out`, `no_convergence`, ...)."""


class DeviceError(FastError):
    """A device did not answer, or answered with a fault. The message says what it means for the batch."""


class InterlockError(DeviceError):
    """An action was refused because its safety precondition does not hold."""


class LostLeaseError(FastError):
    """What this process owned in the lake (a campaign, the gantry) is another's by now; it stops."""


class LakeError(FastError):
    """The lake could not be read or written. Rows already in it are untouched."""


def describe_cause(error: OSError) -> str:
    """Tell why a folder cannot be written; a file in its place is "File exists" to the system."""
    return f"{error.filename} is no folder" if isinstance(error, FileExistsError) else str(error.strerror)


def spell_reason(reason: str) -> str:
    """Spell why a simulation failed in words; a reason that is a sentence already, or of another version, as it is."""
    return REASON_WORDS.get(reason, reason)
