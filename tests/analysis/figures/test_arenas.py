from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from robosim.analysis.figures.arenas import save_gallery, save_picture
from robosim.arena import Zone, load_arena
from robosim.errors import InputError


def test_a_picture_is_to_scale_and_small(tmp_path: Path) -> None:
    path = tmp_path / "paper.png"
    arena = load_arena("paper")
    save_picture([arena], path)
    image = matplotlib.image.imread(path)[..., :3]
    assert path.stat().st_size < 100_000
    wall = np.abs(image - np.array([0x4A, 0x4F, 0x57]) / 255).max(axis=-1) < 0.03
    rows, columns = np.nonzero(wall)
    width, height = columns.max() - columns.min() + 1, rows.max() - rows.min() + 1
    # The legend's wall patch lies below the map, the map's own rows are the long ones.
    long_rows = np.flatnonzero(wall.sum(axis=1) > 0.3 * width)
    assert (long_rows.max() - long_rows.min() + 1) / width == pytest.approx(
        arena.size[1] / arena.size[0], rel=0.02
    )
    assert height >= long_rows.max() - long_rows.min()


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("no/such/x.png", "No such file or directory"),
        ("folder.png", "it is a folder; give the name of a file"),
    ],
)
def test_what_cannot_be_written_is_one_sentence(tmp_path: Path, name: str, why: str) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError) as caught:
        save_picture([load_arena("paper")], tmp_path / name)
    assert str(caught.value) == f"{tmp_path / name}: cannot be written: {why}."
    assert [path.name for path in tmp_path.iterdir()] == ["folder.png"]


def test_only_png(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        save_picture([load_arena("paper")], tmp_path / "x.jpg")
    assert str(caught.value) == f"{tmp_path}/x.jpg: a picture is written as PNG; its name must end in .png."
    assert not list(tmp_path.iterdir())


def test_a_gallery_has_a_map_for_each_arena(tmp_path: Path) -> None:
    path = tmp_path / "gallery.png"
    arenas = [load_arena("paper"), load_arena("s-bend")]
    save_gallery(arenas, path)
    pixels = (255 * matplotlib.image.imread(path)[..., :3]).round()
    # Half the picture for each, to one scale: walls as many times as wide as there are cells of them.
    halves = np.split(pixels, 2, axis=1)
    walls = [(half == (0x4A, 0x4F, 0x57)).all(axis=2).sum() for half in halves]
    cells = [(arena.zones == Zone.WALL).sum() for arena in arenas]
    assert walls[0] / walls[1] == pytest.approx(cells[0] / cells[1], rel=0.03)
    with pytest.raises(InputError, match=r"its name must end in \.png"):
        save_gallery(arenas, tmp_path / "gallery.jpg")
