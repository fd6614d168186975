"""Every error a person can meet, with one sentence that says what, value, limit and what to do next."""


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


def tell_cause(error: OSError) -> str:
    """Why a folder cannot be written; a file in its place is "File exists" to the system."""
    return f"{error.filename} is no folder" if isinstance(error, FileExistsError) else str(error.strerror)
