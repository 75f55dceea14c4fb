"""The registry of export formats: one line and one folder per format.

The code of a format is a function `write(settings, artifacts, folder) -> str`. It writes the artifacts' content into an
empty folder, and returns the card's text on the format. A format of students gets one artifact.
"""

from acgd.settings import Kind

EXPORTS: dict[str, Kind] = {
    "lerobot": Kind("acgd.export.lerobot.settings:LeRobotSettings", "acgd.export.lerobot.write:write"),
    "robomimic": Kind("acgd.export.robomimic.settings:RobomimicSettings", "acgd.export.robomimic.write:write"),
    "minari": Kind("acgd.export.minari.settings:MinariSettings", "acgd.export.minari.write:write"),
    "onnx": Kind("acgd.export.onnx.settings:OnnxSettings", "acgd.export.onnx.write:write"),
}
