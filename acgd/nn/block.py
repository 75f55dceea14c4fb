"""The transformer layer of phi_act and psi_dec."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class Block(nn.Module):
    """Pre-norm transformer layer: attention over [context, tokens], then a feed-forward network.

    One attention replaces the self-attention and cross-attention of ACT, at two thirds of the cost.
    """

    def __init__(self, width: int, heads: int, expansion: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_attention = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, width)
        self.norm_feedforward = nn.LayerNorm(width)
        self.feedforward = nn.Sequential(
            nn.Linear(width, expansion * width), nn.ReLU(), nn.Linear(expansion * width, width)
        )

    def forward(self, tokens: Tensor, context: Tensor | None = None) -> Tensor:
        """tokens (B, n, d), context (B, m, d) or None -> (B, n, d). Tokens (1, n, d) serve all rows of the context."""
        normed = self.norm_attention(tokens)
        query, sources = self.query(normed), self.key_value(normed)
        if context is not None:
            query, sources = (x.expand(context.shape[0], -1, -1) for x in (query, sources))
            sources = torch.cat([self.key_value(context), sources], dim=1)
        key, value = sources.chunk(2, dim=-1)
        attended = F.scaled_dot_product_attention(self._split(query), self._split(key), self._split(value))
        tokens = tokens + self.out(attended.transpose(1, 2).flatten(2))
        return tokens + self.feedforward(self.norm_feedforward(tokens))

    def _split(self, x: Tensor) -> Tensor:
        """(B, n, d) -> (B, heads, n, d / heads)."""
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)
