"""What a user can mend, as one line; what each outcome means for the shell."""

from __future__ import annotations

EXIT_OK = 0
EXIT_BAD_INPUT = 2
EXIT_NOT_REGISTERED = 3
EXIT_INTERRUPTED = 130
"""What shells make of the signal."""

# Set to 1, this environment variable of Hydra's brings the traceback of every error.
FULL_ERROR = "HYDRA_FULL_ERROR"

# What Open3D loads and a bare Debian lacks.
DEBIAN_LIBRARIES = "libusb-1.0-0 libgl1 libegl1 libgomp1"

# What a user can mend. Anything else is a bug of ours and keeps its traceback.
USER_ERRORS = (ValueError, OSError, ImportError)


def is_user_error(error: BaseException) -> bool:
    """Whether the user can mend this: bad values, files, packages, options."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    if isinstance(error, ImportError) and (error.name or "").split(".")[0] == "skipnet":
        return False
    return isinstance(error, (*USER_ERRORS, HydraException, OmegaConfBaseException))


def was_interrupted(error: BaseException | None) -> bool:
    """Whether an interrupt from the keyboard stands behind this, as where it met an import."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def one_line(error: BaseException) -> str:
    """The error's message without line breaks; OSErrors name their file, Hydra's their cause.

    >>> one_line(ValueError("too few points:\\n  got 2"))
    'too few points: got 2'
    """
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    message = " ".join(str(error).split()) or type(error).__name__
    if "cannot open shared object file" in message:
        return f"{message}; on Debian: apt-get install {DEBIAN_LIBRARIES}"
    if type(error).__module__.startswith("hydra") and error.__cause__ is not None:
        # OmegaConf's first line says what is wrong, the others where in its own classes.
        return f"{message}: {str(error.__cause__).splitlines()[0]}"
    return message
