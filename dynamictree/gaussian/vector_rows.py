"""Transpose rows of a table to columns of a buffer and back, sixteen at a time in vector registers.

LLVM vectorizes loops over columns, but not loops that gather or write rows, which took most of the time of a frame.
These intrinsics for numba kernels use LLVM's vector types, which it lowers to the shuffles of any processor. Each is
equivalent to the loop in its docstring.
"""

from typing import no_type_check

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

LANES = 16
CACHE_LINE_BYTES = 64

_FLOAT_BYTES = 4
_INDEX = ir.IntType(64)


@intrinsic
@no_type_check
def gather_columns(typing_context, table, rows, first, columns, at, stride):
    """For j, k < 16: columns[at + k * stride + j] = table[rows[first + j], k]; the table is 16 columns wide."""

    def generate(context, builder, signature, arguments):
        table, rows, first, columns, at, stride = arguments
        table, rows, columns = (_data(context, builder, signature, arguments, position) for position in (0, 1, 3))
        loaded = []
        for lane in range(LANES):
            row = builder.zext(builder.load(builder.gep(rows, [_plus(builder, first, lane)])), _INDEX)
            loaded.append(_load(builder, builder.gep(table, [builder.mul(row, _number(LANES))])))
        for k, column in enumerate(_transposed(builder, loaded)):
            _store(builder, column, builder.gep(columns, [_in_column(builder, at, stride, k)]))
        return context.get_dummy_value()

    return types.void(table, rows, types.int64, columns, types.int64, types.int64), generate


@intrinsic
@no_type_check
def scatter_columns(typing_context, columns, at, stride, table, first):
    """For j, k < 16: table[first + j, k] = columns[at + k * stride + j]; the table is 16 columns wide."""

    def generate(context, builder, signature, arguments):
        columns, table = (_data(context, builder, signature, arguments, position) for position in (0, 3))
        _, at, stride, _, first = arguments
        loaded = [_load(builder, builder.gep(columns, [_in_column(builder, at, stride, k)])) for k in range(LANES)]
        for lane, row in enumerate(_transposed(builder, loaded)):
            start = builder.mul(_plus(builder, first, lane), _number(LANES))
            _store(builder, row, builder.gep(table, [start]))
        return context.get_dummy_value()

    return types.void(columns, types.int64, types.int64, table, types.int64), generate


@no_type_check
def _interleaving(width, *, streamed):
    @intrinsic
    @no_type_check
    def interleave(typing_context, columns, at, stride, flat, first):
        """For j < 16, k < width: flat[first + width * j + k] = columns[at + k * stride + j].

        With `streamed`, the values bypass the caches, and flat[first] must be aligned to a cache line.
        """

        def generate(context, builder, signature, arguments):
            columns, flat = (_data(context, builder, signature, arguments, position) for position in (0, 3))
            _, at, stride, _, first = arguments
            loaded = [_load(builder, builder.gep(columns, [_in_column(builder, at, stride, k)])) for k in range(width)]
            loaded += loaded[-1:] * (4 - width)
            halves = [builder.shuffle_vector(a, b, _lanes(range(2 * LANES))) for a, b in (loaded[:2], loaded[2:])]
            for piece in range(width):
                places = [divmod(piece * LANES + lane, width) for lane in range(LANES)]  # (j, k)
                mixed = builder.shuffle_vector(*halves, _lanes(k * LANES + j for j, k in places))
                target = builder.gep(flat, [_plus(builder, first, piece * LANES)])
                _store(builder, mixed, target, streamed=streamed)
            return context.get_dummy_value()

        return types.void(columns, types.int64, types.int64, flat, types.int64), generate

    return interleave


interleave3, interleave4 = _interleaving(3, streamed=False), _interleaving(4, streamed=False)
stream3, stream4 = _interleaving(3, streamed=True), _interleaving(4, streamed=True)


@no_type_check
def _transposed(builder, rows):
    """Transpose a square: swap blocks of 8 × 8, then 4 × 4, 2 × 2 and 1 × 1 across the diagonal."""
    rows, size = list(rows), LANES // 2
    while size:
        upper = [lane if not lane & size else LANES + lane - size for lane in range(LANES)]
        lower = [lane + size if not lane & size else LANES + lane for lane in range(LANES)]
        for i in (row for row in range(LANES) if not row & size):
            a, b = rows[i], rows[i + size]
            rows[i] = builder.shuffle_vector(a, b, _lanes(upper))
            rows[i + size] = builder.shuffle_vector(a, b, _lanes(lower))
        size //= 2
    return rows


@no_type_check
def _data(context, builder, signature, arguments, position):
    """Return the address of an array's first value."""
    return context.make_array(signature.args[position])(context, builder, value=arguments[position]).data


@no_type_check
def _load(builder, address):
    vector = ir.VectorType(ir.FloatType(), LANES)
    return builder.load(builder.bitcast(address, vector.as_pointer()), align=_FLOAT_BYTES)


@no_type_check
def _store(builder, value, address, *, streamed=False):
    align = CACHE_LINE_BYTES if streamed else _FLOAT_BYTES
    stored = builder.store(value, builder.bitcast(address, value.type.as_pointer()), align=align)
    if streamed:
        stored.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)]))


@no_type_check
def _in_column(builder, at, stride, k):
    return builder.add(at, builder.mul(stride, _number(k)))


@no_type_check
def _plus(builder, value, number):
    return builder.add(value, _number(number))


@no_type_check
def _number(value):
    return ir.Constant(_INDEX, value)


@no_type_check
def _lanes(lanes):
    lanes = list(lanes)
    return ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes)
