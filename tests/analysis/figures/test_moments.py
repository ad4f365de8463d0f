from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from robosim.analysis.figures.moments import Moment, save_moments
from robosim.envs.vector import VectorEnv


def share(image: np.ndarray, colour: tuple[int, int, int]) -> float:
    """The pixels of a colour, as a share of all."""
    return float((np.abs(image * 255 - colour).max(axis=-1) < 3).mean())


@pytest.mark.parametrize("laden", [0, 1, 4])
def test_robots_are_drawn_where_they_are_and_in_red_where_they_hold_a_pellet(
    tmp_path: Path, laden: int
) -> None:
    env = VectorEnv("paper", robots=4)
    env.reset(seed=0)
    frame = env.frame()
    moment = Moment.of(frame, env.arena, "before it begins")
    moment.laden[:laden] = True
    save_moments([moment], tmp_path / "moment.png")
    image = matplotlib.image.imread(tmp_path / "moment.png")[..., :3]
    map_only = image[: int(0.85 * len(image))]
    red, blue = share(map_only, (0xC0, 0x39, 0x2B)), share(map_only, (0x2B, 0x6C, 0xB0))
    assert (red > 0.0, blue > 0.0) == (laden > 0, laden < 4)
    assert red == pytest.approx((red + blue) * laden / 4, rel=0.05)


def test_a_moment_stays_when_the_episode_goes_on() -> None:
    env = VectorEnv("paper", robots=2)
    env.reset(seed=0)
    moment = Moment.of(env.frame(), env.arena, "")
    before = moment.poses.copy()
    for _ in range(5):
        env.step(np.zeros((1, 2), int))
    np.testing.assert_array_equal(moment.poses, before)
    assert (env.frame().pose != before).any()
