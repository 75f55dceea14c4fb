"""Vision of an acting student: features of its frozen backbone, or images for a student with a CNN."""

import numpy as np
import torch
from torch import Tensor, nn


class Perception:
    """Converts images and goal images (n, H, W, 3) uint8 to the form of the student's training data."""

    def __init__(self, backbone: nn.Module | None, *, uses_goal: bool, device: torch.device) -> None:
        """backbone: frozen, (B, H, W, 3) uint8 -> (B, F); None for a student with a CNN."""
        self.backbone, self.uses_goal, self.device = backbone, uses_goal, device

    @torch.inference_mode()
    def see(self, images: np.ndarray) -> Tensor:
        """Features (n, F) of images (n, H, W, 3), or the images."""
        pixels = torch.as_tensor(np.ascontiguousarray(images), device=self.device)
        return pixels if self.backbone is None else self.backbone(pixels)

    def see_goals(self, images: np.ndarray | None) -> np.ndarray | None:
        """Features (n, F) or images of goal images; None for a student without goal images.

        Raises ValueError where the student needs goal images and `images` is None.
        """
        if not self.uses_goal:
            return None
        if images is None:
            raise ValueError(
                "there are no goal images, and this student was trained with one. Give goal images, or train a student "
                "with imitation.goal_image: off."
            )
        return self.see(images).cpu().numpy()

    def tensor(self, array: np.ndarray | None) -> Tensor | None:
        """The array as a tensor on the student's device; None stays None."""
        return None if array is None else torch.as_tensor(array, device=self.device)
