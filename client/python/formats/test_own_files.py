"""Our own files agree with each other."""

import numpy as np
import pytest
from sets import NAMES, SETS, truths


@pytest.mark.parametrize("name", NAMES)
def test_labels_describe_the_instance_image(name):
    for truth in truths(SETS / name):
        assert set(np.unique(truth.instance)) - {0} == set(truth.shown)
        for shown in truth.shown.values():
            np.testing.assert_allclose(truth.camera @ shown.camera, shown.world, atol=1e-6)
            np.testing.assert_allclose(truth.ego @ shown.ego, shown.world, atol=1e-6)
            rows, columns = np.nonzero(shown.mask)
            visible = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            assert shown.record["box_visible"] == visible and shown.record["visible_pixels"] == len(rows)


def test_the_sets_hold_what_they_are_for():
    assert any(truth.ignore is not None for truth in truths(SETS / "removed")), "nothing is ignored"
    clips = truths(SETS / "clips")
    assert max(truth.record["frame_id"] for truth in clips) == 4
    speeds = [np.linalg.norm(s.velocity) for t in clips for s in t.shown.values() if s.velocity is not None]
    assert max(speeds) > 1, "nothing moves"
