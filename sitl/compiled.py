"""Compilation of the flight model: numba with the machine code cached on disk."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """`numba.njit(cache=True)` that keeps the function's type for type checkers."""
    return cast(F, numba.njit(cache=True)(function))
