"""Newton's method near the double root of the fluidity equation; numpy only.

F = (A^2 d^2/xi^2) (g - g_loc) vanishes at mu_s and, close to it, where g = g_loc. Far from both
the two are one double root, at which Newton's method halves the error in each iteration, and the
residual falls by a factor of 4. There the chord of F serves better than its tangent: the chord over
which F changes by what the residual asks for. It tends to the tangent as the residual vanishes, so
the method stays quadratic.
"""

import numpy as np


def chord(slope, curvature, change):
    """Return the slope of the chord of a function over which it changes by ``change``.

    Of F + F' x + F'' x^2/2 = F + change, the root that is close to x = change/F' has the chord::

        change/x = (F' + sign(F') sqrt(F'^2 + 2 F'' change))/2

    Where that is steeper than the tangent, the tangent is returned. Where there is no root, x goes
    to the extremum of the parabola, whose chord is F'/2.

    Parameters
    ----------
    slope, curvature, change : ndarray, (points, n)
        F', F'' and the change.
    """
    below = np.minimum(2.0 * curvature * change, 0.0)
    root = np.sqrt(np.maximum(slope**2 + below, 0.0))
    return (slope + np.copysign(root, slope)) / 2.0
