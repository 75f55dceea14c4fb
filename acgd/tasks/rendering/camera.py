"""Where a task is seen from. Each kind of task has its `CAMERA` in its file in acgd/tasks/kinds/.

The paper's camera, `hand_side_inter`, shows the hand from half a metre: at 84 px it is 25 px long, PenTwirl's target
hides the hand, and a centimetre is less than two pixels. These are closer (2.6 to 5 mm a pixel) and show goal
and object apart.
"""

from dataclasses import dataclass

import mujoco
import numpy as np


@dataclass(frozen=True)
class Camera:
    """A camera at rest in the world, `distance` metres from the point that it looks at."""

    lookat: tuple[float, float, float]
    """World coordinates, metres."""
    distance: float
    """Metres; the picture is 0.83 times as wide at that point."""
    azimuth: float
    """Degrees about the vertical."""
    elevation: float
    """Degrees; -90 looks straight down."""

    def direction(self, turned: float = 0.0, raised: float = 0.0) -> np.ndarray:
        """Unit vector (3,) of sight, or of light from `turned` degrees to the right and `raised` above."""
        azimuth, elevation = np.deg2rad([self.azimuth + turned, self.elevation - raised])
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])

    def build(self) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat
        camera.distance, camera.azimuth, camera.elevation = self.distance, self.azimuth, self.elevation
        return camera
