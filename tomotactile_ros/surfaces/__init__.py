"""How a sheet is bent: where its points lie in space, and which way is out.

Bending without stretching changes no resistance, so the physics stays that of the flat sheet;
surfaces only say where its results lie.
"""

from tomotactile_ros.surfaces.base import Surface
from tomotactile_ros.surfaces.mesh import Mesh
from tomotactile_ros.surfaces.point_grid import PointGrid
from tomotactile_ros.surfaces.simple import Cylinder, Flat

__all__ = ["Cylinder", "Flat", "Mesh", "PointGrid", "Surface"]
