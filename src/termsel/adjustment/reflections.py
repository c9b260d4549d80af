"""The inner loop of the kernels: Householder reflections applied to eight columns at a time.

It is written for LLVM, as numba has no vector type and leaves the loop scalar: that costs a
factor of four. Eight sums advance side by side from row to row, so that nothing is reordered to
vectorise them, and there is no fused multiply-add, which some machines lack: the result is the
same whatever the width of the registers.

Compiled kernels are kept on disk until `kernels.py` changes; numba does not see changes here.
"""

from __future__ import annotations

from functools import partial, reduce
from typing import Any

from termsel.adjustment.compiled import LazyKernel
from termsel.adjustment.numba_settings import import_numba

LANES = 8
"""Columns of a panel."""


def _reflector_code(count: int) -> Any:
    """Return code that applies `count` consecutive reflections, 1 or 2, to one panel.

    It is called as apply(panels, reflections, c, t, stop): reflections from t on are applied to
    rows t to stop of panel c. Panels are (panels, rows, LANES). Reflections are a tuple that
    begins with vectors (reflections, rows), beta (reflections,) and gram (reflections,), all
    contiguous; gram[t] is the product of vectors t and t + 1, for two reflections.

    With reflections I - beta v v' it subtracts v1 a1 + v2 a2 from the rows of panel P, where
    a1 = beta1 v1' P and a2 = beta2 (v2' P - (v2' v1) a1).
    """
    import_numba()
    import numba
    from llvmlite import ir
    from numba.extending import intrinsic

    row_of_lanes = ir.VectorType(ir.DoubleType(), LANES)
    undefined = ir.Constant(row_of_lanes, ir.Undefined)
    first = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)

    # The same value in all lanes.
    def spread(builder: Any, value: Any) -> Any:
        single_lane = builder.insert_element(undefined, value, ir.IntType(32)(0))
        return builder.shuffle_vector(single_lane, undefined, first)

    def over_rows(builder: Any, row: Any, stop: Any, step: int, sums: list[Any],
                  body: Any) -> tuple[Any, list[Any]]:
        """Loop while `step` rows remain, carrying `sums`, which `body` updates and returns."""
        entry = builder.block
        loop_head, loop_body, loop_end = (builder.append_basic_block() for _ in range(3))
        builder.branch(loop_head)
        builder.position_at_end(loop_head)
        # Values that change from turn to turn: the row, and the sums.
        current_row = builder.phi(row.type)
        carried = [builder.phi(row_of_lanes) for _ in sums]
        following = builder.add(current_row, row.type(step))
        builder.cbranch(builder.icmp_signed("<=", following, stop), loop_body, loop_end)
        builder.position_at_end(loop_body)
        changed = body(current_row, carried)
        for phi, initial, new in zip([current_row, *carried], [row, *sums], [following, *changed],
                                     strict=True):
            phi.add_incoming(initial, entry)
            phi.add_incoming(new, builder.block)
        builder.branch(loop_head)
        builder.position_at_end(loop_end)
        return current_row, carried

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        """Write the code of one call (see `_reflector_code` for what it computes)."""
        panels_type, reflections_type = signature.args[:2]
        panels_value, reflections_value, c, t, stop = args
        panels = context.make_array(panels_type)(context, builder, panels_value)
        vectors, beta, gram = (
            context.make_array(array_type)(context, builder,
                                           builder.extract_value(reflections_value, i))
            for i, array_type in enumerate(reflections_type.types[:3]))
        height = builder.extract_value(panels.shape, 1)
        # A row of a panel is one vector; panel c begins after c times the height of all.
        data = builder.bitcast(panels.data, row_of_lanes.as_pointer())
        panel = builder.gep(data, [builder.mul(c, height)])
        index = [builder.add(t, t.type(i)) for i in range(count)]
        v = [builder.gep(vectors.data, [builder.mul(i, height)]) for i in index]
        factors = [spread(builder, builder.load(builder.gep(beta.data, [i]))) for i in index]

        def load(row: Any) -> tuple[Any, Any, list[Any]]:
            address = builder.gep(panel, [row])
            # No more than numpy promises: panels of some callers begin anywhere.
            return address, builder.load(address, align=8), [
                spread(builder, builder.load(builder.gep(vector, [row]))) for vector in v]

        def accumulate(row: Any, sums: list[Any]) -> list[Any]:
            """Add the products of some rows to partial sums, which are independent of each other.
            """
            new = []
            for i in range(0, len(sums), count):
                _, values, weights = load(builder.add(row, row.type(i // count)))
                new += [builder.fadd(total, builder.fmul(weight, values))
                        for total, weight in zip(sums[i:i + count], weights, strict=True)]
            return new

        zero = ir.Constant(row_of_lanes, [0.0] * LANES)
        # Four sums that do not wait for each other: of 4 rows, or of 2 rows and both reflections.
        row, sums = over_rows(builder, t, stop, 4 // count, [zero] * 4, accumulate)
        # Rows that are left over go to the first sum of each reflection.
        _, first_sums = over_rows(builder, row, stop, 1, sums[:count], accumulate)
        a = [reduce(builder.fadd, [first, *sums[i + count::count]])
             for i, first in enumerate(first_sums)]
        a[0] = builder.fmul(factors[0], a[0])
        # The second reflection meets a panel that the first has changed: a2 of the docstring.
        if count == 2:
            product = spread(builder, builder.load(builder.gep(gram.data, [t])))
            a[1] = builder.fmul(factors[1], builder.fsub(a[1], builder.fmul(product, a[0])))

        def subtract(row: Any, _: list[Any]) -> list[Any]:
            """Subtract the multiples of the reflection's vectors from some rows."""
            address, values, weights = load(row)
            products = [builder.fmul(weight, factor)
                        for weight, factor in zip(weights, a, strict=True)]
            change = products[0] if count == 1 else builder.fadd(*products)
            builder.store(builder.fsub(values, change), address, align=8)
            return []

        over_rows(builder, t, stop, 1, [], subtract)
        return context.get_dummy_value()

    def apply(_context: Any, panels: Any, reflections: Any, c: Any, t: Any, stop: Any) -> Any:
        del c, t, stop
        integer = numba.types.intp
        return numba.types.void(panels, reflections, integer, integer, integer), generate

    return intrinsic(apply)


apply_one = LazyKernel(partial(_reflector_code, 1))
apply_two = LazyKernel(partial(_reflector_code, 2))
