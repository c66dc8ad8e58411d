# %% [markdown]
# # The theory of the band
# The growth rate of a disturbance of homogeneous compression depends on its wave vector. In the
# local model all short waves grow. The non-local model has a cut-off and therefore a finite
# wavelength (equation 3.4 of Li & Henann 2019).

# %%
import matplotlib.pyplot as plt
import numpy as np

from pgran.material.laws.bingham import Bingham
from pgran.theory import specimen, waves

law, amplitude, inertial_number = Bingham(0.3819, 0.9377), 0.48, 0.001
models = {model: waves.Coefficients.of(law, model, inertial_number) for model in ("ngf", "li")}
cutoff = float(waves.cutoff(models["ngf"]))
print(f"waves longer than {2 * np.pi * amplitude / cutoff:.1f} d grow in NGF")

# %%
k = np.linspace(0.002, 0.3, 200)
figure, axes = plt.subplots(layout="constrained")
for model, coefficients in models.items():
    direction = waves.fastest(models["ngf"])[2]
    angle = np.radians(waves.direction_angle(direction, waves.PURE_SHEAR))
    rate = waves.pure_shear_growth(k * np.cos(angle), k * np.sin(angle), coefficients)
    axes.plot(k, rate, label=model.upper())
axes.axhline(0, color="grey", linewidth=0.8)
axes.set(xlabel="wave number, k A d", ylabel="growth rate, in viscous units",
         ylim=(-0.001, 0.001))
axes.legend()
figure.savefig("results/theory.png")

# %% [markdown]
# In a finite specimen the band begins as an antisymmetric (sway) mode, whose growth rate has an
# analytical solution.

# %%
rate = specimen.growth_rate(law=law, model="ngf", inertial_number=inertial_number, width=40.0,
                            height=120.0, amplitude=amplitude, density=0.0, relaxation_time=None)
print(f"growth rate of the sway mode: {rate} gdot0")
