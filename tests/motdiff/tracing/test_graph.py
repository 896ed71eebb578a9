"""The graph of a drawn path: a loop without a crossing is cut where it bends most."""

import cv2
import numpy as np

from motdiff.tracing.graph import branch_graph

TIP = (52, 40)  # of a drop whose round end is to the left


def test_a_loop_is_cut_at_its_sharpest_bend():
    turn = np.radians(np.arange(60, 301, 5))
    arc = np.stack([22 + 14 * np.cos(turn), 40 + 14 * np.sin(turn)], axis=1)
    outline = np.rint(np.vstack([TIP, arc])).astype(np.int32)
    mask = np.zeros((80, 80), dtype=np.uint8)
    cv2.polylines(mask, [outline], isClosed=True, color=1)
    graph = branch_graph(mask > 0)
    (branch,) = graph.branches
    assert np.hypot(*(graph.nodes[branch.node_pair[0]] - TIP)) < 3
    np.testing.assert_array_equal(branch.points[0], branch.points[-1])
    length = np.hypot(*np.diff(branch.points, axis=0).T).sum()
    assert 85 < length < 130  # once around
