"""Where each task is seen from."""

from dataclasses import dataclass

import mujoco


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

    def build(self) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat
        camera.distance, camera.azimuth, camera.elevation = self.distance, self.azimuth, self.elevation
        return camera


CAMERAS: dict[str, Camera] = {
    "key-turn": Camera((-0.18, -0.54, 1.43), 0.36, 150.0, -35.0),
    "obj-hold": Camera((-0.23, -0.53, 1.43), 0.36, 150.0, -35.0),
    "pen-twirl": Camera((-0.13, -0.52, 1.42), 0.50, 90.0, -35.0),
    "pose": Camera((-0.18, -0.53, 1.44), 0.34, 150.0, -35.0),
    "reach": Camera((-0.18, -0.53, 1.44), 0.34, 150.0, -35.0),
}
"""By task kind."""
