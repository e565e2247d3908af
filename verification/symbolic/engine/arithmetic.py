"""Corrects a computation of angr 9.2.213.

The overflow flag of an unsigned multiplication comes from the upper half of the product.
angr treats the lower half as the whole product, so that no multiplication ever overflows.
`replay.py` searches for similar faults: it runs each path on the processor.
"""

import angr
import claripy
from angr.engines.vex.claripy import ccall
from claripy.ast import BV

ANGRS_OWN = ccall.pc_actions_UMUL


def unsigned_product(
    _state: angr.SimState,
    bits: int,
    left: BV,
    right: BV,
    _flags_before: BV,
    platform: str | None = None,
) -> BV | tuple[BV, ...]:
    """Returns the flags after MUL of two values of this many bits."""
    product = left[bits - 1 : 0].zero_extend(bits) * right[bits - 1 : 0].zero_extend(bits)
    low, high = product[bits - 1 : 0], product[2 * bits - 1 : bits]
    carry = claripy.If(high != 0, claripy.BVV(1, 1), claripy.BVV(0, 1))
    return ccall.pc_make_rdata(
        ccall.data[platform]["size"],
        carry,
        ccall.calc_paritybit(low),
        claripy.BVV(0, 1),
        ccall.calc_zerobit(low),
        low[bits - 1],
        carry,
        platform=platform,
    )


def mend(mended: bool) -> None:
    """Puts it right for this process, or leaves it as it was."""
    ccall.pc_actions_UMUL = unsigned_product if mended else ANGRS_OWN
