"""The site: floors, walls, areas, cameras and their geometry, access points, zones; read from one YAML file."""

from shared.site.camera_geometry import CameraGeometry
from shared.site.floor_plan import FloorPlan
from shared.site.site_file import AccessPoint, Area, Camera, Floor, Site, Source, Zone
from shared.site.site_loading import SiteError, load_site
from shared.site.view_map import CameraViews, ViewMap, camera_views

__all__ = [
    "AccessPoint",
    "Area",
    "Camera",
    "CameraGeometry",
    "CameraViews",
    "Floor",
    "FloorPlan",
    "Site",
    "SiteError",
    "Source",
    "ViewMap",
    "Zone",
    "camera_views",
    "load_site",
]
