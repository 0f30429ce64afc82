"""A window for pictures, by Python's toolkit tkinter; needed for live views only."""

import os
from typing import Any

import numpy as np

from warpvox.errors import DisplayError
from warpvox.system import has_display

SWITCH = "WARPVOX_WINDOW"
OTHERWISE = f"Render pictures instead (mode 'rgb_array'), or set {SWITCH}=none to go on without showing anything."
"""Advice for machines without a window, for error messages."""


def wanted() -> bool:
    """Return whether windows are allowed: False with ``WARPVOX_WINDOW=none``, for scripts on servers."""
    choice = os.environ.get(SWITCH, "")
    if choice not in ("", "none"):
        raise DisplayError(f"{SWITCH} must be 'none' or not set, got '{choice}'.")
    return not choice


def why_no_window() -> str | None:
    """Return why this machine cannot show a window ("there is no display ..."); None if it can.

    A display that is named but does not answer is only noticed by :class:`Window`. With ``WARPVOX_WINDOW=none`` nothing
    does: windows then show nothing.
    """
    if not wanted():
        return None
    try:
        import tkinter  # noqa: F401
    except ImportError:
        return "this Python has no tkinter (on Debian and Ubuntu: the package python3-tk)"
    if not has_display("DISPLAY"):
        return "there is no display (DISPLAY is not set)"
    return None


class Window:
    """A window that shows a stream of pictures, to be used from one thread only.

    Args:
        size: width and height of the pictures in pixels.

    Attributes:
        closed: whether the window is gone, by :meth:`close` or by the person in front of it.

    Raises:
        DisplayError: there is no display, or Python came without tkinter.
    """

    def __init__(self, size: tuple[int, int], title: str) -> None:
        reason = why_no_window()
        if reason is not None:
            raise DisplayError(f"Cannot open a window: {reason}. {OTHERWISE}")
        self.closed = False
        self._root = None
        if not wanted():
            return
        import tkinter

        try:
            self._root = tkinter.Tk()
        except tkinter.TclError as error:
            raise DisplayError(f"Cannot open a window: {error}. {OTHERWISE}") from None
        self._root.title(title)
        self._root.resizable(False, False)
        self._root.protocol("WM_DELETE_WINDOW", self.close)
        self._image: Any = tkinter.PhotoImage(master=self._root, width=size[0], height=size[1])
        tkinter.Label(self._root, borderwidth=0, image=self._image).pack()

    def show(self, frame: np.ndarray) -> None:
        """Show a picture, uint8 ``[height, width, 3]``, and process window events; does nothing once closed."""
        if self.closed or self._root is None:
            return
        height, width = frame.shape[:2]
        # Tk reads this format by itself, so that no other package has to know about Tk.
        self._image.configure(data=b"P6 %d %d 255\n" % (width, height) + np.ascontiguousarray(frame).tobytes())
        self._root.update()

    @property
    def visible(self) -> bool:
        """Whether the window is open."""
        return self._root is not None

    @property
    def place(self) -> tuple[int, int]:
        """Position (x, y) of the window on the screen; (0, 0) without a window."""
        return (0, 0) if self._root is None else (self._root.winfo_x(), self._root.winfo_y())

    def hide(self) -> None:
        """Hide the window until :meth:`unhide`."""
        if self._root is not None:
            self._root.withdraw()
            self._root.update()

    def unhide(self) -> None:
        """Show the hidden window again."""
        if self._root is not None:
            self._root.deiconify()
            self._root.update()

    def close(self) -> None:
        """Close the window, if it is open."""
        self.closed = True
        if self._root is not None:
            self._root.destroy()
            self._root = None
