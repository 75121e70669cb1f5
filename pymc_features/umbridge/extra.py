"""The library of UM-Bridge, which is an extra."""

from types import ModuleType


def umbridge() -> ModuleType:
    """The library.

    Raises
    ------
    ImportError
        If it is not installed; the message says how to.
    """
    try:
        import umbridge as library
    except ImportError as error:
        raise ImportError(
            "models and samplers over UM-Bridge need its library. Install it: "
            "pip install pymc-features[umbridge]"
        ) from error
    return library
