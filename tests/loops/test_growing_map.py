"""The parts before a submap, in blocks: each of them in one, and few blocks of few kinds."""

from __future__ import annotations

from segloc.loops.growing_map import blocks_of


def test_blocks_hold_each_part_once_and_are_few() -> None:
    kinds = set()
    for known in range(300):
        blocks = blocks_of(known)
        assert [part for block in blocks for part in block] == list(range(known))
        assert len(blocks) <= known.bit_length()
        kinds.update(blocks)
    assert sum(map(len, kinds)) <= 300 * 9  # each part is laid out once a size of blocks
