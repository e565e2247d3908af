"""Explores SM2's Kani harnesses as machine code, with angr."""

import logging

# Before angr is imported: it warns of parts that it does not find and that nobody needs here.
logging.disable(logging.CRITICAL)
