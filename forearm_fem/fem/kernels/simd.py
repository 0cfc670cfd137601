"""Vectors of a processor's registers in compiled code: numba alone does not keep sums of several columns in them.

Memory is given by its address, as in ``multifrontal.blas``. Where registers are shorter the compiler takes several.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model


class Vector(types.Type):
    """numba's type of a vector of ``count`` numbers."""

    def __init__(self, name: str, number: Any, count: int) -> None:
        self.lanes = ir.VectorType(number, count)
        base: Any = super()
        base.__init__(name=name)


@register_model(Vector)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        base: Any = super()
        base.__init__(manager, kind, kind.lanes)


_doubles, _floats = Vector("eight doubles", ir.DoubleType(), 8), Vector("sixteen floats", ir.FloatType(), 16)
_eight_floats = Vector("eight floats", ir.FloatType(), 8)

_find: Any = cgutils.get_or_insert_function
_ALIGNED = 4  # bytes: of a float


@intrinsic
def no_doubles(context: Any) -> Any:
    """Eight zeros in double precision."""
    return _doubles(), _zeros


@intrinsic
def no_floats(context: Any) -> Any:
    """Sixteen zeros in single precision."""
    return _floats(), _zeros


@intrinsic
def doubles_at(context: Any, address: Any) -> Any:
    """The eight doubles at ``address``."""
    return _doubles(types.intp), _load


@intrinsic
def as_doubles(context: Any, address: Any, like: Any) -> Any:
    """The eight numbers at ``address`` in double precision; there they are of the type of the array ``like``."""
    single = like.dtype == types.float32

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """A load, widened where it is of single precision."""
        kind = (_eight_floats if single else _doubles).lanes
        found = builder.load(builder.inttoptr(arguments[0], kind.as_pointer()), align=_ALIGNED)
        return builder.fpext(found, _doubles.lanes) if single else found

    return _doubles(types.intp, like), build


@intrinsic
def floats_at(context: Any, address: Any) -> Any:
    """The sixteen floats at ``address``."""
    return _floats(types.intp), _load


@intrinsic
def no_eight_floats(context: Any) -> Any:
    """Eight zeros in single precision."""
    return _eight_floats(), _zeros


@intrinsic
def vector_at(context: Any, address: Any, like: Any) -> Any:
    """The numbers at ``address``, as many as the vector ``like`` holds."""
    return like(types.intp, like), _load


@intrinsic
def store(context: Any, address: Any, vector: Any) -> Any:
    """Write ``vector`` to ``address``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """A store."""
        place = builder.inttoptr(arguments[0], signature.args[1].lanes.as_pointer())
        builder.store(arguments[1], place, align=_ALIGNED)
        return context.get_dummy_value()

    return types.void(types.intp, vector), build


@intrinsic
def plus_scaled(context: Any, total: Any, vector: Any, factor: Any) -> Any:
    """``total`` + ``factor`` times ``vector``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """A fused multiplication and addition."""
        return _plus_scaled(builder, signature.return_type, *arguments)

    return total(total, total, types.float64 if total == _doubles else types.float32), build


@intrinsic
def plus_scaled_by(context: Any, total: Any, vector: Any, address: Any) -> Any:
    """``total`` + ``vector`` times the number at ``address``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """The same, with the factor loaded first."""
        total, vector, address = arguments
        factor = builder.load(builder.inttoptr(address, signature.return_type.lanes.element.as_pointer()))
        return _plus_scaled(builder, signature.return_type, total, vector, factor)

    return total(total, total, types.intp), build


@intrinsic
def plus_turned(context: Any, total: Any, vector: Any) -> Any:
    """``total`` + i ``vector``, for vectors of real and imaginary parts in turn."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Neighbours exchanged, and added with signs in turn."""
        lanes = signature.return_type.lanes
        index = ir.VectorType(ir.IntType(32), lanes.count)
        exchanged = ir.Constant(index, [k ^ 1 for k in range(lanes.count)])
        swapped = builder.shuffle_vector(arguments[1], arguments[1], exchanged)
        signs = ir.Constant(lanes, [1.0 if k % 2 else -1.0 for k in range(lanes.count)])
        return builder.call(_multiply_add(builder, signature.return_type), [swapped, signs, arguments[0]])

    return total(total, total), build


@intrinsic
def minus(context: Any, total: Any, vector: Any) -> Any:
    """``total`` - ``vector``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """A subtraction."""
        return builder.fsub(*arguments)

    return total(total, total), build


@intrinsic
def plus(context: Any, total: Any, vector: Any) -> Any:
    """``total`` + ``vector``."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """An addition."""
        return builder.fadd(*arguments)

    return total(total, total), build


@intrinsic
def pointer(context: Any, address: Any) -> Any:
    """``address`` as numba's ``carray`` takes it."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """A cast of the address."""
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.intp), build


def _zeros(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return ir.Constant(signature.return_type.lanes, [0.0] * signature.return_type.lanes.count)


def _load(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    lanes = signature.return_type.lanes
    return builder.load(builder.inttoptr(arguments[0], lanes.as_pointer()), align=_ALIGNED)


def _plus_scaled(builder: Any, kind: Any, total: Any, vector: Any, factor: Any) -> Any:
    lanes, index = kind.lanes, ir.IntType(32)
    nothing = ir.Constant(lanes, ir.Undefined)
    first = builder.insert_element(nothing, factor, ir.Constant(index, 0))
    spread = builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(index, lanes.count), [0] * lanes.count))
    return builder.call(_multiply_add(builder, kind), [spread, vector, total])


def _multiply_add(builder: Any, kind: Any) -> Any:
    lanes, find = kind.lanes, _find
    suffix = "f64" if lanes.element == ir.DoubleType() else "f32"
    return find(builder.module, ir.FunctionType(lanes, [lanes] * 3), f"llvm.fmuladd.v{lanes.count}{suffix}")
