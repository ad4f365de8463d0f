from robosim.arena import load_arena
from robosim.arena.draw import drawing


def test_the_drawing_is_the_file_s() -> None:
    arena = load_arena("s-bend")
    assert "\n".join(drawing(arena)) in arena.text
