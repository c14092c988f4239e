"""What people, walls and obstacles do to a walk [ravel-thesis §7]: forces, walls nobody walks through."""

from services.fusion.forces.obstacles import Obstacles
from services.fusion.forces.social_forces import ForceSettings, displacement
from services.fusion.forces.walls import stay_walkable, walkable_share

__all__ = [
    "ForceSettings",
    "Obstacles",
    "displacement",
    "stay_walkable",
    "walkable_share",
]
