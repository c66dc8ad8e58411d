# %% [markdown]
# # A user-defined law
# A law is one class in one file, here `power_law.py`. The option `law` names file and class.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from power_law import PowerLaw

import pgran

law = PowerLaw(mu_s=0.26, c=0.8, n=0.5)
I = np.geomspace(1e-4, 1.0, 100)
figure, axes = plt.subplots(layout="constrained")
axes.semilogx(I, law.stress_ratio(I)[0])
axes.set(xlabel="I", ylabel="mu")
figure.savefig("results/own_law.png")

# %% [markdown]
# The specimen with this law. The law has no cooperativity length, so it needs the local model.

# %%
path = Path(pgran.__file__).parents[1] / "docs" / "examples" / "power_law.py"
result = pgran.run("results/own_law.h5", options_file=path.parents[2] / "options" / "direct.opts",
                   law=f"{path}:PowerLaw", model="li", shear_modulus=200, compression=0.005,
                   snapshots=[0.005])
last = result.snapshots[-1]
print(f"{last.label}: I from {last['inertial_number'].min():.2e} to "
      f"{last['inertial_number'].max():.2e}")
