"""Maps of an area, learned as people walk: where they go, what stands in their way, radio and magnetism."""

from services.learning.maps.area_maps import AreaMaps

__all__ = ["AreaMaps"]
