"""All formats of export: one line and one folder each.

The code of a format is `write(settings, artifacts, folder) -> str`: it writes the artifacts' content into an empty
folder, and returns what the card says of the format. A student's format is given one artifact.
"""

from acgd.settings import Kind

EXPORTS: dict[str, Kind] = {
    "lerobot": Kind("acgd.export.lerobot.settings:LeRobotSettings", "acgd.export.lerobot.write:write"),
    "robomimic": Kind("acgd.export.robomimic.settings:RobomimicSettings", "acgd.export.robomimic.write:write"),
    "minari": Kind("acgd.export.minari.settings:MinariSettings", "acgd.export.minari.write:write"),
    "onnx": Kind("acgd.export.onnx.settings:OnnxSettings", "acgd.export.onnx.write:write"),
}
