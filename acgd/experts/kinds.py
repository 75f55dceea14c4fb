"""Sources of experts: the zoo, or a learner. A new learner is one folder and one line."""

from acgd.settings import Kind

LEARNERS: dict[str, Kind] = {
    "zoo": Kind("acgd.experts.settings:ZooSettings", "acgd.experts.train:take"),
    "ppo": Kind("acgd.experts.ppo.settings:PPOSettings", "acgd.experts.ppo.learn:train_ppo"),
    "sac": Kind("acgd.experts.sac.settings:SACSettings", "acgd.experts.sac.learn:train_sac"),
    "muscle": Kind("acgd.experts.muscle.settings:MuscleSettings", "acgd.experts.muscle.learn:train_muscle"),
}
"""The code is `function(request, state, metrics, progress, device) -> (folder, points)`. `folder` holds the expert's
files. `points` is the learning curve, empty for an expert from the zoo."""
