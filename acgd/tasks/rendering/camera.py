"""Cameras of the tasks. Each kind of task defines `CAMERA` in its file in acgd/tasks/kinds/.

The paper's camera, `hand_side_inter`, is half a metre from the hand: in 84 px the hand is 25 px long, a centimetre is
less than two pixels, and PenTwirl's target hides the hand. These cameras are closer (2.6 to 5 mm per pixel), and goal
and object do not overlap.
"""

from dataclasses import dataclass

import numpy as np

from acgd.tasks.simulator import mujoco


@dataclass(frozen=True)
class Camera:
    """A static camera in the world, `distance` metres from the point `lookat`."""

    lookat: tuple[float, float, float]
    """World coordinates, metres."""
    distance: float
    """Metres. The width of the picture at `lookat` is 0.83 times the distance."""
    azimuth: float
    """Degrees about the vertical axis."""
    elevation: float
    """Degrees; -90 looks straight down."""

    def direction(self, turned: float = 0.0, raised: float = 0.0) -> np.ndarray:
        """Unit vector (3,) of the line of sight, turned by `turned` degrees to the right and `raised` degrees up."""
        azimuth, elevation = np.deg2rad([self.azimuth + turned, self.elevation - raised])
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])

    def build(self) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat
        camera.distance, camera.azimuth, camera.elevation = self.distance, self.azimuth, self.elevation
        return camera
