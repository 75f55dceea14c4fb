"""How a student that acts sees images: as the features of its frozen backbone, or as they are."""

import numpy as np
import torch
from torch import Tensor, nn


class Perception:
    """Images and goal images (n, H, W, 3) uint8 as the student was trained to read them."""

    def __init__(self, backbone: nn.Module | None, *, uses_goal: bool, device: torch.device) -> None:
        """`backbone`: frozen, (B, H, W, 3) uint8 -> (B, F); None for a student that owns its CNN."""
        self.backbone, self.uses_goal, self.device = backbone, uses_goal, device

    @torch.inference_mode()
    def see(self, images: np.ndarray) -> Tensor:
        """Features (n, F), or the images."""
        pixels = torch.as_tensor(np.ascontiguousarray(images), device=self.device)
        return pixels if self.backbone is None else self.backbone(pixels)

    def see_goals(self, images: np.ndarray | None) -> np.ndarray | None:
        """The same for goal images, as an array to remember; None for a student without a goal image."""
        if not self.uses_goal:
            return None
        if images is None:
            raise ValueError(
                "this student was trained with a goal image: give goal images, "
                "or train one with imitation.goal_image: off"
            )
        return self.see(images).cpu().numpy()

    def tensor(self, array: np.ndarray | None) -> Tensor | None:
        """On the student's device; None stays None."""
        return None if array is None else torch.as_tensor(array, device=self.device)
