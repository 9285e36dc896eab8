"""What compression may cost, what is worth it, and on how many views it is measured. See docs/experiments."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CompressionSettings:
    """Losses are dB on the validation images. Shares are of the Gaussians in question, in [0, 1].

    Attributes:
        max_freeze_loss, max_final_freeze_loss: for freezing motion: where steps make up for it, and at the end.
        max_prune_loss: for pruning Gaussians.
        max_unmissed_loss, unmissed_weight: at the end, for pruning what has no larger blending weight than that in any
            training image.
        max_packing_loss: above which a file is not packed.
        freeze_score, freeze_all_score: score (see ``Motion``) below which motion may be frozen; and below which all may
            be, if no score is above.
        max_pruned: share of the Gaussians, at a milestone.
        num_sensitivity_views, num_budget_views: views that sensitivity is measured on, without and with a budget: where
            Gaussians have to be weighed, few times and sides must be missed.
        num_weight_views: training images that blending weights are looked for in.
        num_training_views: training images that stand in for validation images, where there are none.
        validate_from, prune_at: fractions of the training between which validation images are not learned from: long
            enough that they lose what held-out images lose, and no longer, since what is static then cannot learn them.
    """

    max_freeze_loss: float = 0.05
    max_final_freeze_loss: float = 0.02
    max_prune_loss: float = 0.03
    max_unmissed_loss: float = 0.01
    max_packing_loss: float = 0.05
    unmissed_weight: float = 0.1
    freeze_score: float = 4.0
    freeze_all_score: float = 2.0
    max_pruned: float = 0.6
    num_sensitivity_views: int = 24
    num_budget_views: int = 72
    num_weight_views: int = 120
    num_training_views: int = 8
    validate_from: float = 0.75
    prune_at: float = 0.8


DEFAULT = CompressionSettings()
