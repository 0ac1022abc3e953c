"""Import of optional packages on first use, with a message that names the extra if one is missing."""

from importlib import import_module
from types import ModuleType


def optional(package: str, extra: str, use: str) -> ModuleType:
    """An optional package.

    Raises:
        ValueError: If it is not installed; the message names the extra that brings it.

    >>> optional("no_such_package", "io", "the format x")
    Traceback (most recent call last):
    ValueError: the format x needs no_such_package; install it with: pip install 'jaxtissue[io]'
    """
    try:
        return import_module(package)
    except ImportError as error:
        told = f"{use} needs {package}; install it with: pip install 'jaxtissue[{extra}]'"
        raise ValueError(told) from error
