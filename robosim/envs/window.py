"""What an environment shows while it runs: arrays of pixels, or a window for `render_mode="human"`.

Tk comes with Python and takes pictures as bytes, so that a window costs no further library.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from robosim.envs.render import Painter, Pixels, render_metadata
from robosim.errors import InputError

if TYPE_CHECKING:
    import tkinter as tk

    from robosim.envs.vector import VectorEnv


class Screen:
    """What an environment's `render` returns and shows, by its render mode."""

    def __init__(self, batch: VectorEnv, mode: str | None) -> None:
        """`batch` is what is drawn, its first environment."""
        self._batch = batch
        self._mode = mode
        self._painter = Painter(batch.arena)
        fps = render_metadata(batch.arena)["render_fps"]
        self._window = Window(f"robosim: {batch.arena.name}", fps) if mode == "human" else None

    def update(self) -> None:
        """Show the present moment, if a person is to see every decision."""
        if self._window is not None:
            self._window.show(self._painter.draw(self._batch.frame()))

    def render(self) -> Pixels | None:
        """Return a picture [height, width, 3] if arrays are asked for; InputError before a reset."""
        if self._mode is None:
            return None
        if self._batch.episode < 0:
            raise InputError("render: no episode has begun; call reset first.")
        return self._painter.draw(self._batch.frame()) if self._mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()


class Window:
    """Shows pictures at most `per_second` in a second; a person may close it, and then nothing is shown."""

    def __init__(self, title: str, per_second: float) -> None:
        """Open it with the first picture, not before."""
        self._title = title
        self._seconds = 1.0 / per_second
        self._root: tk.Tk | None = None
        self._closed = False
        self._shown_at = -float("inf")

    def show(self, picture: Pixels) -> None:
        """Show a picture [height, width, 3], once the one before has been seen long enough.

        InputError where no window can be opened.
        """
        if self._closed:
            return
        time.sleep(max(0.0, self._shown_at + self._seconds - time.monotonic()))
        self._shown_at = time.monotonic()
        root = self._root or self._open()
        height, width = picture.shape[:2]
        self._image.configure(data=b"P6 %d %d 255 " % (width, height) + picture.tobytes())
        root.update()

    def close(self) -> None:
        """Close it; nothing is shown any more."""
        self._closed = True
        if self._root is not None:
            self._root.destroy()
            self._root = None

    def _open(self) -> tk.Tk:
        try:
            import tkinter as tk
        except ImportError as error:
            raise InputError(
                f'render_mode "human" needs tkinter, a part of Python that is missing here ({error}).'
            ) from None
        try:
            root = tk.Tk()
        except tk.TclError as error:
            raise InputError(f'render_mode "human" needs a display for its window: {error}.') from None
        root.title(self._title)
        root.resizable(width=False, height=False)
        root.protocol("WM_DELETE_WINDOW", self.close)
        self._image = tk.PhotoImage(master=root)
        tk.Label(root, image=self._image, borderwidth=0).pack()
        self._root = root
        return root
