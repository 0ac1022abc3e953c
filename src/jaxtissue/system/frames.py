"""Tables for pandas, which is an optional dependency."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any


def as_frame(columns: Mapping[str, Any]) -> Any:
    """A pandas `DataFrame` of columns of one length.

    Args:
        columns: Arrays or lists by name.

    Raises:
        ImportError: If pandas is not installed; the message says how to get it.
    """
    try:
        pandas = import_module("pandas")
    except ImportError as error:
        raise ImportError("to_pandas() needs pandas; install it with: pip install 'jaxtissue[io]'") from error
    return pandas.DataFrame(dict(columns))
