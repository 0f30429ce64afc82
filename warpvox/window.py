"""A window that shows pictures, by the toolkit that comes with Python; nothing needs it but live views."""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np

from warpvox.errors import DisplayError

__all__ = ["Window", "why_no_window"]


def why_no_window() -> str | None:
    """What keeps this machine from showing a window, as half a sentence ("there is no display ..."), or None.

    A display that is named but does not answer is only noticed by :class:`Window`.
    """
    try:
        import tkinter  # noqa: F401
    except ImportError:
        return "this Python has no tkinter (on Debian and Ubuntu: the package python3-tk)"
    draws_on_x11 = sys.platform not in ("win32", "darwin", "cygwin")
    if draws_on_x11 and not os.environ.get("DISPLAY"):
        return "there is no display (DISPLAY is not set)"
    return None


class Window:
    """A window that shows one picture after the other. Use it from one thread only.

    Args:
        size: width and height of the pictures in pixels.
        title: what stands above.

    Attributes:
        closed: whether the window is gone, by :meth:`close` or by the person in front of it.

    Raises:
        DisplayError: there is no display, or Python came without tkinter.
    """

    def __init__(self, size: tuple[int, int], title: str) -> None:
        reason = why_no_window()
        if reason is not None:
            raise DisplayError(f"Cannot open a window: {reason}. Render pictures instead (mode 'rgb_array').")
        import tkinter

        width, height = size
        try:
            self._root = tkinter.Tk()
        except tkinter.TclError as error:
            raise DisplayError(f"Cannot open a window: {error}. Render pictures instead (mode 'rgb_array').") from None
        self.closed = False
        self._root.title(title)
        self._root.resizable(False, False)
        self._root.protocol("WM_DELETE_WINDOW", self.close)
        self._label = tkinter.Label(self._root, borderwidth=0, width=width, height=height)
        self._label.pack()
        self._image: Any = tkinter.PhotoImage(master=self._root, width=width, height=height)
        self._label.configure(image=self._image)

    def show(self, frame: np.ndarray) -> None:
        """Show a picture, uint8 ``[height, width, 3]``, and answer mouse and keyboard; nothing once closed."""
        if self.closed:
            return
        height, width = frame.shape[:2]
        # Tk reads this format by itself, so that no other package has to know about Tk.
        self._image.configure(data=b"P6 %d %d 255\n" % (width, height) + np.ascontiguousarray(frame).tobytes())
        self._root.update()

    def hide(self) -> None:
        """Take the window off the screen until :meth:`unhide`."""
        if not self.closed:
            self._root.withdraw()
            self._root.update()

    def unhide(self) -> None:
        """Bring a hidden window back."""
        if not self.closed:
            self._root.deiconify()
            self._root.update()

    def close(self) -> None:
        """Close the window. Harmless to repeat."""
        if not self.closed:
            self.closed = True
            self._root.destroy()
