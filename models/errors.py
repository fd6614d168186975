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


class MeshingFailed(FastError):
    """A mesher gave no usable mesh; `reason` is a short machine-readable word (`time_out`, `crash`, ...)."""

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class SimulationFailed(FastError):
    """A grasp simulation ended without a result; `reason` is a short machine-readable word."""

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class DeviceError(FastError):
    """A device did not answer, or answered with a fault. The message says what it means for the batch."""


class InterlockError(DeviceError):
    """An action was refused because its safety precondition does not hold."""


class LakeError(FastError):
    """The lake could not be read or written. Rows already in it are untouched."""
