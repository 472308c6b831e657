"""Compilation of the flight model: numba with the machine code cached on disk."""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])

SOURCES = ("constants.py", "control.py", "flight_model.py", "physics.py")
"""The modules with compiled functions."""


@cache
def stamp() -> bytes:
    """Digest of all compiled sources."""
    here = Path(__file__).parent
    return hashlib.sha256(b"".join((here / name).read_bytes() for name in SOURCES)).digest()


def compiled(function: F) -> F:
    """`numba.njit(cache=True)` that keeps the function's type for type checkers.

    numba throws cached code away when the function's own file has changed; here also when the file of a function has
    that it calls, since that one's code is part of it.
    """
    dispatcher: Any = numba.njit(cache=True)(function)
    with suppress(AttributeError):  # numba's own business: without it the cache is only as good as numba's
        dispatcher._cache._cache_file._source_stamp = stamp()
    return cast(F, dispatcher)
