"""Explores SM2's Kani harnesses as machine code, with angr."""

import logging

# Set before angr is imported, which warns of missing parts that are not needed here.
logging.disable(logging.CRITICAL)
