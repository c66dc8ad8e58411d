"""Linear theory of waves and specimens, and one-dimensional profiles; numpy and scipy only."""

import numpy as np


def check_relaxation_time(model, value):
    """Raise ValueError unless ``value`` is t0 > 0 of ngf_primitive, or None for another model."""
    if (model == "ngf_primitive") != (value is not None):
        raise ValueError(f"relaxation time: the model {model} "
                         f"{'needs one' if value is None else 'has none'}")
    if value is not None and not (np.greater(value, 0.0) & np.isfinite(value)).all():
        raise ValueError(f"relaxation time {value}: must be a number > 0")


def inverse_length_squared(law, mu):
    """Return A^2 d^2/xi^2 of (2.8) and its derivative; ValueError for a law without this length."""
    if law.inverse_length_squared is None:
        raise ValueError(f"the law {type(law).__name__} has no cooperativity length, which NGF "
                         "needs; expected model li")
    return law.inverse_length_squared(mu)
