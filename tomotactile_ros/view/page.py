"""A page for the browser with sheets in 3-D: pressure, contacts, electrodes, curves of forces.

The page is made with viser, which is installed apart (`pip install "viser>=1.1"`): a pure Python
server whose page holds all that a browser needs, so that it works without the internet. It listens
on this machine only, unless another address is asked for.
"""

from __future__ import annotations

import logging
import socket
from contextlib import suppress
from typing import Any

import numpy as np

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.spatial import Pose
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.view.page_sheet import Sheet

MISSING = (
    'the page in the browser needs viser, which is not installed here: pip install "viser>=1.1"'
)
LOCALHOST, PORT = "127.0.0.1", 8080


class Page:
    """A server of one page; a context manager.

    Parameters
    ----------
    title : of the page, behind `tomotactile`.
    host, port : where it listens; the next free port where that one is taken, 0 for any.
    calibrated : whether a contact law gives forces; otherwise conductances are shown.
    """

    def __init__(
        self, title: str, host: str = LOCALHOST, port: int = PORT, calibrated: bool = True
    ):
        try:
            import rich
            import viser
        except ImportError:
            raise InputError(MISSING) from None
        check_address(host, port)
        rich.reconfigure(quiet=True)  # what viser says of itself, and of browsers that hang up
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        self.calibrated = calibrated
        title = f"tomotactile {title}".rstrip()
        self.server: Any = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        shown = "localhost" if host in ("0.0.0.0", "::") else host
        self.url = f"http://{shown}:{self.server.get_port()}"
        self.sheets: dict[str, Sheet] = {}
        gui = self.server.gui
        gui.main_panel.dock_right()
        self._dark(False)
        self._head = gui.add_markdown(title, order=0.0)
        dark = gui.add_checkbox("dark", False, order=1e6)
        dark.on_update(lambda event: self._dark(dark.value))
        scene = self.server.scene
        scene.configure_default_lights(enabled=False)  # colours are pressures, not light and shade
        scene.configure_environment_map(None)
        scene.add_light_ambient("/light", intensity=np.pi)
        scene.set_up_direction("+z")
        self.server.on_client_connect(self._welcome)

    def __enter__(self) -> Page:  # noqa: PYI034 - typing has Self from 3.11 on
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(RuntimeError):  # of an event loop that has ended
            self.server.stop()

    def say(self, text: str) -> None:
        """A line at the top."""
        self._head.content = text

    def add_sheet(self, name: str, *shape: Any) -> Sheet:
        """A sheet under a name; one of that name goes. `shape` as of `Sheet`."""
        if name in self.sheets:
            self.remove_sheet(name)
        sheet = self.sheets[name] = Sheet(self, name, *shape)
        self._look_again()
        return sheet

    def remove_sheet(self, name: str) -> None:
        """Take a sheet off the page."""
        self.sheets.pop(name).remove()

    def place(self, sheet: Sheet, pose: Pose) -> None:
        """Where a sheet is on the robot."""
        first = sheet.place(pose)
        if first:
            self._look_again()

    def add_layout(self, layout: Layout, grid: Grid) -> Sheet:
        """The sheet of a layout, with the cells of its images."""
        cells = layout.surface.to_3d(grid.centres).reshape(*grid.shape, 3)
        electrodes = layout.surface.to_3d(layout.positions)
        shape = cells, grid.cell_size, grid.inside, electrodes, layout.radius
        return self.add_sheet(layout.name, *shape, layout)

    @property
    def is_watched(self) -> bool:
        """Whether somebody has the page open."""
        return bool(self.server.get_clients())

    def _dark(self, dark: bool) -> None:
        self.server.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def _welcome(self, client: Any) -> None:
        """Show all that is known to somebody who has just come."""
        self._look_at_all(client.camera)
        for sheet in list(self.sheets.values()):
            sheet.show_again()

    def _look_again(self) -> None:
        for client in self.server.get_clients().values():
            self._look_at_all(client.camera)

    def _look_at_all(self, camera: Any) -> None:
        """From where all sheets are seen; on a narrow picture, whose words are below, in its upper part."""
        if not self.sheets:
            return
        places = np.vstack([sheet.places_in_world() for sheet in self.sheets.values()])
        size = np.ptp(places, axis=0).max() * max(1.0, 0.67 / camera.aspect)
        middle = (places.max(axis=0) + places.min(axis=0)) / 2
        middle[1] -= 0.75 * size * (camera.aspect < 1.0)
        camera.position = middle + size * np.array([0.0, -0.9, 1.2])
        camera.look_at = middle


def check_address(host: str, port: int) -> None:
    """Refuse, as InputError, where nobody can listen: viser would try for ever."""
    checks.integer(port, "port", 0, 65535)
    try:
        socket.create_server((host, 0)).close()
    except OSError as error:
        raise InputError(f"host: nobody can listen at {host}: {error.strerror}") from None
