"""Where an expert comes from: a trained one, or a learner. A new learner is a folder and a line."""

from acgd.settings import Kind

LEARNERS: dict[str, Kind] = {
    "zoo": Kind("acgd.experts.settings:ZooSettings", "acgd.experts.train:take"),
    "ppo": Kind("acgd.experts.ppo.settings:PPOSettings", "acgd.experts.ppo.learn:train_ppo"),
    "sac": Kind("acgd.experts.sac.settings:SACSettings", "acgd.experts.sac.learn:train_sac"),
    "muscle": Kind("acgd.experts.muscle.settings:MuscleSettings", "acgd.experts.muscle.learn:train_muscle"),
}
"""The code is `function(request, state, metrics, progress, device) -> (folder, points)`: the folder with the expert's
files, and the points of the learning curve, none where nothing was trained."""
