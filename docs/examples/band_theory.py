# %% [markdown]
# # Linear theory of the band
# A perturbation of homogeneous compression grows at a rate that depends on its wave vector. In the
# local model (LI) all short waves of some directions grow. In the non-local model (NGF) only waves
# longer than a cut-off grow (section 3 of Li & Henann 2019).

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
# A finite specimen first buckles. The antisymmetric (sway) mode has an analytical growth rate.

# %%
rate = specimen.growth_rate(law=law, model="ngf", inertial_number=inertial_number, width=40.0,
                            height=120.0, amplitude=amplitude, density=0.0, relaxation_time=None)
print(f"the sway mode grows at {rate:.1f} gdot0")
