"""Windows: a clear error where none can be shown; where one can, it shows pictures and notices that it was closed."""

import builtins
import os

import numpy as np
import pytest

from warpvox.errors import DisplayError
from warpvox.view.window import Window, why_no_window

tkinter = pytest.importorskip("tkinter")


def test_without_a_display_the_error_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert why_no_window() == "there is no display (DISPLAY is not set)"
    with pytest.raises(DisplayError):
        Window((64, 48), "test")


def test_without_tkinter_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_tkinter(name: str, *args: object) -> object:
        if name == "tkinter":
            raise ImportError(name)
        return real(name, *args)

    monkeypatch.setattr(builtins, "__import__", without_tkinter)
    with pytest.raises(DisplayError):
        Window((64, 48), "test")


def test_a_display_that_does_not_answer_is_an_error_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_answer() -> None:
        raise tkinter.TclError("couldn't connect to display ':99'")

    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(tkinter, "Tk", no_answer)
    with pytest.raises(DisplayError):
        Window((64, 48), "test")


@pytest.mark.skipif("DISPLAY" not in os.environ, reason="no display")
def test_a_window_shows_what_it_is_given() -> None:
    window = Window((64, 48), "test")
    frame = np.zeros((48, 64, 3), np.uint8)
    frame[10:20, 30:40] = (250, 120, 10)
    window.show(frame)
    assert window._image.get(35, 15) == (250, 120, 10)
    assert window._image.get(5, 5) == (0, 0, 0)
    window.hide()
    window.unhide()
    window.close()
    assert window.closed
    window.show(frame)  # nothing happens
    window.close()


@pytest.mark.skipif("DISPLAY" not in os.environ, reason="no display")
def test_a_window_closed_by_hand_stays_closed() -> None:
    window = Window((64, 48), "test")
    window._root.tk.call(*window._root.protocol("WM_DELETE_WINDOW").split())
    assert window.closed


def test_windows_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("WARPVOX_WINDOW", "none")
    assert why_no_window() is None
    window = Window((64, 48), "test")
    window.show(np.zeros((48, 64, 3), np.uint8))
    assert not window.closed
    window.hide()
    window.unhide()
    assert window.place == (0, 0)
    window.close()
    assert window.closed


def test_an_unknown_switch_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WARPVOX_WINDOW", "off")
    with pytest.raises(DisplayError):
        why_no_window()
