"""Dense kernels on tiles of 8 x 8 doubles, written in LLVM's vector types.

A matrix is a column-major part of a flat array of doubles, given by the place of its first entry and the stride
between its columns; row counts are padded to whole tiles, so no kernel has a remainder. The eight columns of a
tile stay in eight vector registers while it collects its inner products, which numba's own vectoriser does not
achieve. Every operation is written out, so the results do not depend on the vector width of the machine.

Numba caches the functions that use these kernels by the file they are in: clear `__pycache__` after a change here.
"""

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

TILE = 8
DOUBLE, PLACE, LANE = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
VECTOR = ir.VectorType(DOUBLE, TILE)
ALIGNMENT = 8  # bytes; parts of an array start anywhere
Value = Any  # an `ir.Value`; llvmlite has no type hints
Emit = Callable[..., Value | None]


class _Code:
    """Writes vector code: an LLVM builder with the flat array it works on."""

    def __init__(self, builder: Any, data: Value) -> None:
        self.builder, self.data = builder, data

    def function(self, name: str, result: Any, *arguments: Any) -> Any:
        """Return a function of LLVM."""
        return cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(result, arguments), name)

    def at(self, place: Value, step: Value | int, times: int = 1) -> Value:
        """Place + step * times."""
        if isinstance(step, int):
            return self.builder.add(place, PLACE(step * times))
        return self.builder.add(place, self.builder.mul(step, PLACE(times)))

    def load(self, place: Value) -> Value:
        """Load eight doubles from `place` on."""
        return self.builder.load(self.pointer(place), align=ALIGNMENT)

    def store(self, value: Value, place: Value) -> None:
        """Write eight doubles."""
        self.builder.store(value, self.pointer(place), align=ALIGNMENT)

    def columns(self, place: Value, stride: Value) -> list[Value]:
        """Load the eight columns of a tile."""
        return [self.load(self.at(place, stride, j)) for j in range(TILE)]

    def scalar(self, place: Value) -> Value:
        """Load one double."""
        return self.builder.load(self.builder.gep(self.data, [place]))

    def spread(self, scalar: Value) -> Value:
        """Spread the scalar to all eight lanes."""
        first = self.builder.insert_element(VECTOR(ir.Undefined), scalar, LANE(0))
        return self.builder.shuffle_vector(first, VECTOR(ir.Undefined), _lanes([0] * TILE))

    def first_lanes(self, count: Value) -> Value:
        """Make the mask of the first `count` lanes."""
        lanes = ir.VectorType(PLACE, TILE)
        first = self.builder.insert_element(lanes(ir.Undefined), count, LANE(0))
        counts = self.builder.shuffle_vector(first, lanes(ir.Undefined), _lanes([0] * TILE))
        return self.builder.icmp_signed("<", lanes(list(range(TILE))), counts)

    def load_lanes(self, place: Value, mask: Value) -> Value:
        """Load the masked ones of eight doubles, 0 for the others."""
        pointer = self.pointer(place)
        load = self.function("llvm.masked.load.v8f64.p0", VECTOR, pointer.type, LANE, mask.type, VECTOR)
        return self.builder.call(load, [pointer, LANE(ALIGNMENT), mask, VECTOR([0.0] * TILE)])

    def store_lanes(self, value: Value, place: Value, mask: Value) -> None:
        """Write the masked ones of eight doubles."""
        pointer = self.pointer(place)
        store = self.function("llvm.masked.store.v8f64.p0", ir.VoidType(), VECTOR, pointer.type, LANE, mask.type)
        self.builder.call(store, [value, pointer, LANE(ALIGNMENT), mask])

    def select(self, first: Value, second: Value, count: int) -> Value:
        """Select the first `count` lanes of `first`, the others of `second`."""
        lanes = _lanes([k if k < count else TILE + k for k in range(TILE)])
        return self.builder.shuffle_vector(first, second, lanes)

    def add_product(self, total: Value, left: Value, right: Value) -> Value:
        """Compute total + left * right."""
        fused = self.function("llvm.fma.v8f64", VECTOR, VECTOR, VECTOR, VECTOR)
        return self.builder.call(fused, [left, right, total])

    def subtract_product(self, total: Value, left: Value, right: Value) -> Value:
        """Compute total - left * right."""
        return self.add_product(total, self.builder.fneg(left), right)

    def pointer(self, place: Value) -> Value:
        """Return a pointer to eight doubles."""
        return self.builder.bitcast(self.builder.gep(self.data, [place]), VECTOR.as_pointer())


def _lanes(numbers: list[int]) -> Value:
    """Tell which lanes of two vectors, the second from 8 on, make up a third."""
    return ir.VectorType(LANE, TILE)(numbers)


def _intrinsic(emit: Emit, n_places: int, result: types.Type = types.void, n_arrays: int = 1) -> tuple[Any, Any]:
    """Declare (arrays, integers) -> result, with code that `emit(*codes of the arrays, *integers)` writes in line."""

    def generate(context: Any, builder: Any, signature: Any, args: Sequence[Value]) -> Value:
        arrays = zip(signature.args[:n_arrays], args[:n_arrays], strict=True)
        codes = [
            _Code(builder, cgutils.create_struct_proxy(kind)(context, builder, array).data) for kind, array in arrays
        ]
        value = emit(*codes, *args[n_arrays:])
        return context.get_dummy_value() if value is None else value

    return result(*[types.float64[::1]] * n_arrays, *[types.int64] * n_places), generate


def _reduced(code: _Code, tile: list[Value], rows: Value, columns: Value, stride: Value, depth: Value) -> list[Value]:
    """Compute tile - A B^T, with A and B (8, depth) from places `rows` and `columns` on."""
    builder = code.builder
    registers = [cgutils.alloca_once_value(builder, column) for column in tile]
    with cgutils.for_range(builder, depth) as loop:
        shift = builder.mul(loop.index, stride)
        left = code.load(builder.add(rows, shift))
        right = builder.add(columns, shift)
        for j, register in enumerate(registers):
            factor = code.spread(code.scalar(code.at(right, j)))
            builder.store(code.subtract_product(builder.load(register), left, factor), register)
    return [builder.load(register) for register in registers]


def _emit_product(
    code: _Code, target: Value, spacing: Value, rows: Value, columns: Value, stride: Value, depth: Value
) -> None:
    zero = VECTOR([0.0] * TILE)
    for j, column in enumerate(_reduced(code, [zero] * TILE, rows, columns, stride, depth)):
        code.store(column, code.at(target, spacing, j))


def _emit_division(code: _Code, target: Value, rows: Value, columns: Value, stride: Value, depth: Value) -> None:
    tile = _reduced(code, code.columns(target, stride), rows, columns, stride, depth)
    pivot = code.builder.add(columns, code.builder.mul(depth, stride))
    for j in range(TILE):
        total = VECTOR([0.0] * TILE)
        for k in range(j + 1):
            inverse = code.spread(code.scalar(code.at(code.at(pivot, stride, k), j)))
            total = code.add_product(total, tile[k], inverse)
        code.store(total, code.at(target, stride, j))


def _emit_pivot(code: _Code, target: Value, rows: Value, stride: Value, depth: Value) -> Value:
    # Elimination with unscaled columns, T = M D M^T, keeps the square roots out of the chain of dependent operations.
    # The rows of M^-1 follow from the same multipliers.
    builder = code.builder
    tile = _reduced(code, code.columns(target, stride), rows, rows, stride, depth)
    inverse = [VECTOR([float(j == k) for k in range(TILE)]) for j in range(TILE)]
    is_positive: Value = ir.IntType(1)(1)
    pivots = VECTOR(ir.Undefined)
    for j in range(TILE):
        pivot = builder.extract_element(tile[j], LANE(j))
        pivots = builder.insert_element(pivots, pivot, LANE(j))
        is_positive = builder.and_(is_positive, builder.fcmp_ordered(">", pivot, DOUBLE(0.0)))
        scaled = builder.fmul(tile[j], code.spread(builder.fdiv(DOUBLE(1.0), pivot)))
        for k in range(j + 1, TILE):
            multiplier = code.spread(builder.extract_element(scaled, LANE(k)))
            tile[k] = code.subtract_product(tile[k], tile[j], multiplier)
            inverse[k] = code.subtract_product(inverse[k], inverse[j], multiplier)
    roots = builder.call(code.function("llvm.sqrt.v8f64", VECTOR, VECTOR), [pivots])
    scales = builder.fdiv(VECTOR([1.0] * TILE), roots)
    upper = [builder.fmul(row, code.spread(builder.extract_element(scales, LANE(j)))) for j, row in enumerate(inverse)]
    lower = _transposed(code, upper)
    for j in range(TILE):
        code.store(code.select(upper[j], lower[j], j + 1), code.at(target, stride, j))
    return is_positive


def _exchange(code: _Code, first: Value, second: Value, distance: int) -> tuple[Value, Value]:
    """Swap the lanes of `first` that have the bit `distance` with those of `second` that have not."""
    low = _lanes([k if not k & distance else TILE + k - distance for k in range(TILE)])
    high = _lanes([k + distance if not k & distance else TILE + k for k in range(TILE)])
    shuffle = code.builder.shuffle_vector
    return shuffle(first, second, low), shuffle(first, second, high)


def _transposed(code: _Code, tile: list[Value]) -> list[Value]:
    """Return the tile's rows, by swaps of ever smaller blocks."""
    tile = list(tile)
    for distance in (4, 2, 1):
        for j in range(TILE):
            if not j & distance:
                tile[j], tile[j + distance] = _exchange(code, tile[j], tile[j + distance], distance)
    return tile


def _column_sums(code: _Code, tile: list[Value]) -> Value:
    """Return the vector of the sums of the eight columns."""
    for distance in (4, 2, 1):
        pairs = [_exchange(code, tile[j], tile[j + distance], distance) for j in range(distance)]
        tile = [code.builder.fadd(low, high) for low, high in pairs]
    return tile[0]


def _emit_placement(code: _Code, blocks: _Code, target: Value, stride: Value, source: Value) -> None:
    builder = code.builder
    most, last = blocks.load(source), blocks.spread(blocks.scalar(blocks.at(source, 8)))
    mask = ir.VectorType(ir.IntType(1), TILE)([k < 3 for k in range(TILE)])
    for j in range(3):
        column = builder.shuffle_vector(most, last, _lanes([j, 3 + j, 6 + j] + [0] * (TILE - 3)))
        code.store_lanes(column, code.at(target, stride, j), mask)


def _emit_addition(
    code: _Code, target: Value, step: Value, source: Value, spacing: Value, n_rows: Value, n_columns: Value
) -> None:
    builder = code.builder
    n_whole = builder.and_(n_rows, PLACE(-TILE))
    mask = code.first_lanes(builder.sub(n_rows, n_whole))
    with cgutils.for_range(builder, n_columns) as column:
        to = builder.add(target, builder.mul(column.index, step))
        come = builder.add(source, builder.mul(column.index, spacing))
        with cgutils.for_range_slice(builder, PLACE(0), n_whole, PLACE(TILE)) as (row, _):
            at = builder.add(to, row)
            code.store(builder.fadd(code.load(at), code.load(builder.add(come, row))), at)
        with builder.if_then(builder.icmp_signed("<", n_whole, n_rows)):
            at = builder.add(to, n_whole)
            total = builder.fadd(code.load_lanes(at, mask), code.load_lanes(builder.add(come, n_whole), mask))
            code.store_lanes(total, at, mask)


def _emit_forward(code: _Code, vector: Value, panel: Value, stride: Value, start: Value) -> None:
    builder = code.builder
    zero = VECTOR([0.0] * TILE)
    corner, top = builder.add(panel, start), builder.add(vector, start)
    sums = [zero, zero]
    for j in range(TILE):
        lower = code.select(zero, code.load(code.at(corner, stride, j)), j)
        sums[j % 2] = code.add_product(sums[j % 2], lower, code.spread(code.scalar(code.at(top, j))))
    solution = builder.fadd(*sums)
    code.store(solution, top)
    solved = [code.spread(builder.extract_element(solution, LANE(j))) for j in range(TILE)]
    with cgutils.for_range_slice(builder, code.at(start, TILE), stride, PLACE(TILE)) as (row, _):
        at = builder.add(vector, row)
        sums = [code.load(at), zero]
        for j in range(TILE):
            column = code.load(code.at(builder.add(panel, row), stride, j))
            sums[j % 2] = code.subtract_product(sums[j % 2], column, solved[j])
        code.store(builder.fadd(*sums), at)


def _emit_backward(code: _Code, vector: Value, panel: Value, stride: Value, start: Value) -> None:
    builder = code.builder
    zero = VECTOR([0.0] * TILE)
    corner, top = builder.add(panel, start), builder.add(vector, start)
    registers = [cgutils.alloca_once_value(builder, zero) for _ in range(TILE)]
    with cgutils.for_range_slice(builder, code.at(start, TILE), stride, PLACE(TILE)) as (row, _):
        known = code.load(builder.add(vector, row))
        for j, register in enumerate(registers):
            column = code.load(code.at(builder.add(panel, row), stride, j))
            builder.store(code.add_product(builder.load(register), column, known), register)
    rest = builder.fsub(code.load(top), _column_sums(code, [builder.load(register) for register in registers]))
    sums = [zero, zero]
    for j in range(TILE):
        upper = code.select(code.load(code.at(corner, stride, j)), zero, j + 1)
        sums[j % 2] = code.add_product(sums[j % 2], upper, code.spread(builder.extract_element(rest, LANE(j))))
    code.store(builder.fadd(*sums), top)


@intrinsic
def product_tile(_: Any, data: Any, target: Any, spacing: Any, rows: Any, columns: Any, stride: Any, depth: Any) -> Any:
    """Write -A B^T to the tile at `target` (columns `spacing` apart); A, B (8, depth) at `rows`, `columns`."""
    return _intrinsic(_emit_product, 6)


@intrinsic
def divide_tile(_: Any, data: Any, target: Any, rows: Any, columns: Any, stride: Any, depth: Any) -> Any:
    """Replace the tile T at `target` by (T - A B^T) P^-T, with the factorised pivot tile P right of B."""
    return _intrinsic(_emit_division, 5)


@intrinsic
def pivot_tile(_: Any, data: Any, target: Any, rows: Any, stride: Any, depth: Any) -> Any:
    """Replace the tile T at `target` by P^-1, and P^-T above the diagonal, with P P^T = T - A A^T; A is at `rows`.

    False if there is no such P. The inverse of so small a factor is as good as substitution, and needs no chain of
    dependent operations.
    """
    return _intrinsic(_emit_pivot, 4, types.boolean)


@intrinsic
def place_block(_: Any, data: Any, blocks: Any, target: Any, stride: Any, source: Any) -> Any:
    """Write the 3 x 3 block, in rows, at `source` of `blocks` to `target` in columns."""
    return _intrinsic(_emit_placement, 3, n_arrays=2)


@intrinsic
def add_block(_: Any, data: Any, target: Any, step: Any, source: Any, spacing: Any, n_rows: Any, n_columns: Any) -> Any:
    """Add the block (n_rows, n_columns) at `source` (columns `spacing` apart) to that at `target` (`step` apart)."""
    return _intrinsic(_emit_addition, 6)


@intrinsic
def forward_strip(_: Any, data: Any, vector: Any, panel: Any, stride: Any, start: Any) -> Any:
    """Solve for rows `start` to `start` + 8 of the panel's vector and subtract their share from the rows below."""
    return _intrinsic(_emit_forward, 4)


@intrinsic
def backward_strip(_: Any, data: Any, vector: Any, panel: Any, stride: Any, start: Any) -> Any:
    """Subtract the share of the rows below from rows `start` to `start` + 8 and solve for them, transposed."""
    return _intrinsic(_emit_backward, 4)
