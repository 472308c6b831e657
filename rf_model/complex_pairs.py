"""Complex numbers as files and messages have them, [re, im], to tensors and back."""

from collections.abc import Sequence
from typing import Annotated

import torch
from pydantic import BeforeValidator, Field, Strict
from torch import Tensor


class ShapeError(ValueError):
    """A matrix of the wrong shape; the text names it, its shape and the one it must have."""


def _pair(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) == 2:
        return value
    raise ValueError(f"{value!r} must be [re, im]")


Part = Annotated[float, Field(ge=-1e6, le=1e6)]
Complex = Annotated[tuple[Part, Part], Strict(False), BeforeValidator(_pair)]
Row = Annotated[tuple[Complex, ...], Strict(False)]
Matrix = Annotated[tuple[Row, ...], Strict(False)]


def to_matrix(name: str, given: Sequence[Sequence[Sequence[float]]], sizes: str, rows: int, columns: int) -> Tensor:
    """Complex [rows, columns]. Raises ShapeError unless it has that shape."""
    widths = sorted({len(row) for row in given})
    if len(given) != rows or widths != [columns]:
        shape = f"{len(given)} x {'/'.join(map(str, widths)) or 0}"
        raise ShapeError(f"{name}: {shape}, must be {sizes} = {rows} x {columns} of [re, im]")
    return torch.view_as_complex(torch.tensor(given, dtype=torch.float64))


def to_pairs(matrix: Tensor) -> list[list[list[float]]]:
    """[re, im] of every element."""
    pairs: list[list[list[float]]] = torch.view_as_real(matrix).tolist()
    return pairs
