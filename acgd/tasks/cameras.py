"""Where each task is seen from.

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


CAMERAS: dict[str, Camera] = {
    "key-turn": Camera((-0.16, -0.555, 1.42), 0.29, 100.0, -40.0),
    "obj-hold": Camera((-0.23, -0.53, 1.43), 0.26, 130.0, -50.0),
    "pen-twirl": Camera((-0.125, -0.53, 1.40), 0.50, 90.0, -50.0),
    "pose": Camera((-0.17, -0.53, 1.43), 0.28, 150.0, -25.0),
    "reach": Camera((-0.17, -0.53, 1.43), 0.28, 150.0, -25.0),
    "bottle": Camera((0.08, -0.6, 0.55), 0.42, -50.0, -30.0),
    "scissors": Camera((0.05, 0.0, 0.64), 0.7, 0.0, -50.0),
    "switch": Camera((0.02, 0.0, 0.71), 0.68, 0.0, -33.0),
    "spray-1": Camera((0.0, -0.08, 0.145), 0.46, 238.0, -34.0),
    "spray-2": Camera((0.0, -0.08, 0.125), 0.46, 238.0, -34.0),
}
"""By task kind."""
