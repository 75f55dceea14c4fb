"""OpDex Spray-1: a round bottle."""

from functools import partial

from acgd.tasks.rendering.camera import Camera
from acgd.tasks.spray import Bottle, SprayScene

CAMERA = Camera((0.0, -0.08, 0.145), 0.46, 238.0, -34.0)
SCENE = partial(SprayScene, Bottle((0.036, 0.036, 0.075), True, 0.016, 0.060))
