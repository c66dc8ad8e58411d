"""Pictures of result files by pyvista, off-screen."""

import ctypes.util
import os
from pathlib import Path

import numpy as np

if not os.environ.get("DISPLAY") and ctypes.util.find_library("OSMesa"):
    # Without a screen VTK tries X first and complains: name the renderer that needs none.
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkOSOpenGLRenderWindow")
import pyvista

from . import reading


def surface(coordinates, fields, closed=(False, False)):
    """Return a pyvista grid of nodes ``coordinates`` (ny, nx, 2) with fields {name: (ny, nx)}.

    ``closed`` says whether the last nodes along x1 and along x2 neighbour the first ones.
    """
    extra = [(0, int(wrap)) for wrap in reversed(closed)]
    coordinates = np.pad(coordinates, [*extra, (0, 0)], mode="wrap")
    fields = {name: np.pad(values, extra, mode="wrap") for name, values in fields.items()}
    ny, nx = coordinates.shape[:2]
    grid = pyvista.StructuredGrid()
    grid.points = np.concatenate([coordinates, np.zeros((ny, nx, 1))], axis=2).reshape(-1, 3)
    grid.dimensions = nx, ny, 1
    for name, values in fields.items():
        grid[name] = np.asarray(values).ravel()
    return grid


def draw(path, grid, name, limits, title, bar=""):
    """Write a picture of the field ``name`` of a plane grid to ``path``, bar at the right."""
    x0, x1, y0, y1, _, _ = grid.bounds
    left, right, above = 40, 180, 60  # margins in pixels
    pixel = max((x1 - x0) / 1200.0, (y1 - y0) / 880.0)
    size = [int(round((x1 - x0) / pixel)) + left + right, int(round((y1 - y0) / pixel)) + 2 * above]
    plotter = pyvista.Plotter(off_screen=True, window_size=size)
    plotter.set_background("white")
    plotter.add_mesh(grid, scalars=name, clim=limits, cmap="viridis", lighting=False,
                     scalar_bar_args={"title": bar, "color": "black", "vertical": True,
                                      "position_x": 1.0 - 0.85 * right / size[0],
                                      "position_y": 0.25, "height": 0.5, "width": 40 / size[0],
                                      "fmt": "%.1e", "n_labels": 5, "title_font_size": 22,
                                      "label_font_size": 16})
    plotter.add_text(title, position="upper_edge", font_size=10, color="black")
    plotter.view_xy()
    plotter.enable_parallel_projection()
    centre = x0 + (size[0] / 2.0 - left) * pixel, (y0 + y1) / 2.0
    plotter.camera.focal_point = (*centre, 0.0)
    plotter.camera.position = (*centre, 1.0)
    plotter.camera.parallel_scale = size[1] * pixel / 2.0
    plotter.screenshot(str(path))
    plotter.close()


def field(path, snapshot, name, title):
    """Draw a scalar field of a snapshot beside the file, NAME.png; return the path."""
    target = Path(path).with_suffix(".png")
    with reading.opened(path, snapshots=1) as file:
        grid = surface(reading.field_of(file, snapshot, "coordinates"),
                       {name: reading.field_of(file, snapshot, name)},
                       file.attrs.get("closed", (False, False)))
    draw(target, grid, name, (grid[name].min(), grid[name].max()), title, bar=name)
    return target


def pictures(path):
    """Draw every snapshot of a result file; return the paths of the pictures.

    Raises `pgran.output.reading.ResultError` where the file is not one of pgran's.
    """
    path, written = Path(path), []
    with reading.opened(path, snapshots=1) as file:
        fields = {name: reading.field_of(file, name, "inertial_number")
                  for name in sorted(file["snapshots"])}
        closed = file.attrs.get("closed", (False, False))
        largest = max(I.max() for I in fields.values())
        for name, I in fields.items():
            target = path.with_name(f"{path.stem}_{name}.png")
            grid = surface(reading.field_of(file, name, "coordinates"), {"I": I}, closed)
            label = file["snapshots"][name].attrs.get("label", "")
            draw(target, grid, "I", (0.0, largest), f"inertial number at {label}")
            written.append(target)
    return written
