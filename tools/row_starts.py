"""Where the rows of a work directory's graph begin: `graph_row_blocks.npy` and `graph_long_rows.npy` as plain starts."""
from pathlib import Path

import numpy


def row_starts(folder, rows):
    """The starts of `rows` rows, and the end (int64, rows + 1)."""
    blocks = numpy.load(Path(folder) / "graph_row_blocks.npy", mmap_mode="r")
    table = numpy.load(Path(folder) / "graph_long_rows.npy", mmap_mode="r")
    # Row k of a block has bit k of three words, least bits first; where the first word has its top bit, a place in the table.
    bits = numpy.unpackbits(blocks[:, 1:].copy().view(numpy.uint8).reshape(len(blocks), 3, 8), axis=2, bitorder="little")
    degrees = bits[:, 0].astype(numpy.int64) + 2 * bits[:, 1] + 4 * bits[:, 2]
    for block in numpy.flatnonzero(blocks[:, 0] >> numpy.uint64(63)):
        place = int(blocks[block, 1])
        degrees[block] = numpy.diff(table[place : place + 65].astype(numpy.int64))
    return numpy.concatenate([[0], numpy.cumsum(degrees.reshape(-1)[:rows])])
