"""The press to try tactile sensors with."""

from pathlib import Path

import numpy as np

from tactile import datasets


def test_the_press_is_written_as_it_was_made(tmp_path: Path) -> None:
    made = datasets.press(tmp_path)
    again = datasets.press()
    assert [f.name for f in made.files] == ["press.npy", "depth.npy"]
    np.testing.assert_array_equal(np.load(made.files[0], allow_pickle=False), again.images)
    np.testing.assert_array_equal(np.load(made.files[1], allow_pickle=False), again.depths)
    assert made.images.shape == (9, 480, 640)
    assert made.images.dtype == np.uint8
    np.testing.assert_allclose(made.forces[[0, 4, 8]], [[0, 0, 0], [0, 0, 0], [0.25, 0, -1]])
    assert not np.array_equal(datasets.press(seed=1).images, made.images)
