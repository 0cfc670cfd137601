"""Vectors of a processor's registers in compiled code: numba alone does not keep sums of several columns in them.

Memory is given by its address, as in :mod:`.frontal.blas`. Where registers are shorter the compiler takes several.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

DOUBLES = 8  # in a vector of them


class Doubles(types.Type):
    """numba's type of a vector of eight doubles."""

    def __init__(self) -> None:
        super().__init__(name="Doubles")


@register_model(Doubles)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        base: Any = super()
        base.__init__(manager, kind, _VECTOR)


_VECTOR = ir.VectorType(ir.DoubleType(), DOUBLES)
_doubles = Doubles()


@intrinsic
def zeros(context: Any) -> Any:
    """A vector of zeros."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return ir.Constant(_VECTOR, [0.0] * DOUBLES)

    return _doubles(), build


@intrinsic
def plus_product(context: Any, total: Any, factor: Any, address: Any) -> Any:
    """``total`` + ``factor`` times the vector at ``address``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        total, factor, address = arguments
        x = builder.load(builder.inttoptr(address, _VECTOR.as_pointer()), align=8)
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        find: Any = cgutils.get_or_insert_function
        function = find(builder.module, kind, f"llvm.fmuladd.v{DOUBLES}f64")
        return builder.call(function, [_spread(builder, factor), x, total])

    return _doubles(_doubles, types.float64, types.intp), build


@intrinsic
def load(context: Any, address: Any) -> Any:
    """The vector at ``address``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(builder.inttoptr(arguments[0], _VECTOR.as_pointer()), align=8)

    return _doubles(types.intp), build


@intrinsic
def store(context: Any, address: Any, vector: Any) -> Any:
    """Write ``vector`` to ``address``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[1], builder.inttoptr(arguments[0], _VECTOR.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(types.intp, _doubles), build


@intrinsic
def pointer(context: Any, address: Any) -> Any:
    """``address`` as numba's ``carray`` takes it."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.intp), build


def _spread(builder: Any, value: Any) -> Any:
    """``value`` in all places of a vector."""
    nothing, index = ir.Constant(_VECTOR, ir.Undefined), ir.IntType(32)
    first = builder.insert_element(nothing, value, ir.Constant(index, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(index, DOUBLES), [0] * DOUBLES))
