"""OpDex Spray-2: a box-shaped bottle."""

from functools import partial

from acgd.tasks.rendering.camera import Camera
from acgd.tasks.spray import Bottle, SprayScene

CAMERA = Camera((0.0, -0.08, 0.125), 0.46, 238.0, -34.0)
SCENE = partial(SprayScene, Bottle((0.045, 0.032, 0.055), False, 0.018, 0.070))
