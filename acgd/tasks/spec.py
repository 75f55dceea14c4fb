"""The table of tasks. This file imports no simulator."""

from dataclasses import dataclass
from importlib import import_module
from types import ModuleType


@dataclass(frozen=True)
class TaskSpec:
    """One task."""

    name: str
    """`<suite>/<task>`, the name in configurations and reports"""
    suite: str
    """Tasks of one suite have the same action and proprio spaces."""
    kind: str
    """State layout, starts and camera: the kind `key-turn` is in acgd/tasks/kinds/key_turn.py."""
    gym_id: str | None
    """Gymnasium id of MyoSuite's environment; None in the suites bidex and opdex."""
    horizon: int
    """Time limit in control steps."""
    privileged: tuple[str, ...]
    """Names of the state entries of object and goal, which a student can only see in the image."""
    goal: str
    """Variation of the goal, and its place in the observation of a policy without the state."""

    @property
    def slug(self) -> str:
        """The name in a path: `myo-key-turn`."""
        return self.name.replace("/", "-")

    @property
    def module(self) -> str:
        """Module of the kind: `acgd.tasks.kinds.key_turn`."""
        return f"acgd.tasks.kinds.{self.kind.replace('-', '_')}"

    @property
    def environment(self) -> str:
        """Import string of the Gymnasium environment."""
        return ENVIRONMENTS[self.suite]

    def code(self) -> ModuleType:
        """The module of the kind: `CAMERA`, and `KIND` (MyoKind) or `SCENE` (constructs a Scene). Imports MuJoCo."""
        return import_module(self.module)


ENVIRONMENTS = {
    "myo": "acgd.tasks.myodex:MyoDexTask",
    "bidex": "acgd.tasks.dexterous:DexterousTask",
    "opdex": "acgd.tasks.dexterous:DexterousTask",
}
"""Suite -> import string of the environment."""

_KEY = ("key_qpos", "key_pos")
_HOLD = ("obj_pos", "goal_pos")
_PEN = ("obj_pos", "obj_rot", "obj_des_rot")
_POSE = ("target_tips",)
_REACH = ("target_pos",)
_SPRAY = ("bottle_pos", "bottle_rot", "trigger")
_BOTTLE = ("bottle_pos",)
_SCISSORS = ("scissors_pos", "scissors_rot")
_SWITCH = ("handle", "rocker")

_SPECS = (
    TaskSpec(
        "myo/key-turn",
        "myo",
        "key-turn",
        "myoHandKeyTurnFixed-v0",
        200,
        _KEY,
        "fixed: turn the key by more than pi; key place and angle are in the image",
    ),
    TaskSpec(
        "myo/key-turn-hard",
        "myo",
        "key-turn",
        "myoHandKeyTurnRandom-v0",
        200,
        _KEY,
        "fixed: turn the key past 2 pi; key place and angle are in the image",
    ),
    TaskSpec(
        "myo/obj-hold",
        "myo",
        "obj-hold",
        "myoHandObjHoldFixed-v0",
        75,
        _HOLD,
        "varies by up to 6 mm an axis: the goal marker is in the image",
    ),
    TaskSpec(
        "myo/obj-hold-hard",
        "myo",
        "obj-hold",
        "myoHandObjHoldRandom-v0",
        75,
        _HOLD,
        "varies by up to 3 cm an axis, as does the object's size: marker and object are in the image",
    ),
    TaskSpec(
        "myo/pen-twirl",
        "myo",
        "pen-twirl",
        "myoHandPenTwirlFixed-v0",
        50,
        _PEN,
        "varies by up to 0.2 rad about two axes: the target pen is in the image",
    ),
    TaskSpec(
        "myo/pen-twirl-hard",
        "myo",
        "pen-twirl",
        "myoHandPenTwirlRandom-v0",
        50,
        _PEN,
        "varies by up to 1 rad about two axes: the target pen is in the image",
    ),
    TaskSpec(
        "myo/pose",
        "myo",
        "pose",
        "myoHandPoseFixed-v0",
        100,
        _POSE,
        "varies by up to 0.15 rad a joint: the fingertips' targets are in the image",
    ),
    TaskSpec(
        "myo/pose-hard",
        "myo",
        "pose",
        "myoHandPoseRandom-v0",
        100,
        _POSE,
        "any hand-sign pose: the fingertips' targets are in the image",
    ),
    TaskSpec(
        "myo/reach",
        "myo",
        "reach",
        "myoHandReachFixed-v0",
        100,
        _REACH,
        "all five targets move together by up to 1.5 cm an axis: they are in the image",
    ),
    TaskSpec(
        "myo/reach-hard",
        "myo",
        "reach",
        "myoHandReachRandom-v0",
        100,
        _REACH,
        "each target varies on its own: they are in the image",
    ),
    TaskSpec(
        "bidex/bottle",
        "bidex",
        "bottle",
        None,
        125,
        _BOTTLE,
        "fixed: the cap off; how the bottle lies in the hand is in the image",
    ),
    TaskSpec(
        "bidex/scissors",
        "bidex",
        "scissors",
        None,
        125,
        _SCISSORS,
        "fixed: the scissors open; where they lie is in the image",
    ),
    TaskSpec(
        "bidex/switch",
        "bidex",
        "switch",
        None,
        125,
        _SWITCH,
        "fixed: both rockers pressed; where the switches stand is in the image",
    ),
    TaskSpec(
        "opdex/spray-1",
        "opdex",
        "spray-1",
        None,
        125,
        _SPRAY,
        "fixed: hold the trigger of a round bottle; the bottle's place and yaw are in the image",
    ),
    TaskSpec(
        "opdex/spray-2",
        "opdex",
        "spray-2",
        None,
        125,
        _SPRAY,
        "fixed: hold the trigger of a box-shaped bottle; the bottle's place and yaw are in the image",
    ),
)

ADVANCED_KINDS = ("key-turn", "pose")
"""Kinds with starts on the way to the goal, by `KIND.advance`."""

GOAL_SIZES = {"obj-hold": 3, "pen-twirl": 3, "pose": 23, "reach": 15}
"""Kinds whose commanded goal varies -> numbers in it, see `goal_vector` of the environments."""

TASKS: dict[str, TaskSpec] = {spec.name: spec for spec in _SPECS}
