"""ACGD: experts, critics, demonstrations, a codebook, and visual students distilled under the critics' guidance."""

ORDER = (
    "settings",
    "store",
    "tracking",
    "tasks",
    "simulate",
    "nn",
    "experts",
    "critics",
    "rollouts",
    "vision",
    "guidance",
    "students",
    "evaluation",
    "collection",
    "export",
    "reports",
    "chain",
    "study",
    "__main__",
)
"""Folders and modules of this package from the bottom: each imports only from itself and from those before it."""
