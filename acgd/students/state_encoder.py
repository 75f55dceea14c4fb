"""phi_state: an MLP over the robot's recent proprioception s_{t-h:t} (Section III-C)."""

from torch import Tensor, nn


class StateEncoder(nn.Module):
    """The robot's own history, never the privileged state, although the paper writes both as s."""

    def __init__(self, history: int, proprio: int, width: int, expansion: int) -> None:
        super().__init__()
        hidden = expansion * width
        self.net = nn.Sequential(
            nn.Linear(history * proprio, hidden), nn.LayerNorm(hidden), nn.ReLU(), nn.Linear(hidden, width)
        )

    def forward(self, proprio: Tensor) -> Tensor:
        """proprio (B, h, P), normalised -> z_state (B, d)."""
        return self.net(proprio.flatten(1))
