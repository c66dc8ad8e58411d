# %% [markdown]
# # A shear band
# A specimen of 40 d x 120 d is compressed to 10 %. The non-local model develops one band, whose
# width is set by the rheology. Use `ranks=2` to run on two ranks.

# %%
import matplotlib.pyplot as plt

import pgran

result = pgran.run("results/band.h5", inertial_number=0.001, snapshots=[0.05, 0.1])
print(result)

# %% [markdown]
# Angle and width of the band. The stress on the upper plate decreases when the flow localises.

# %%
band = result.snapshots[-1].band()
if band["angle"] is not None:
    print(f"angle {band['angle']:.1f} degrees, width {band['width']:.1f} d")

figure, axes = plt.subplots(layout="constrained")
axes.plot(100 * result.history["compression"], result.history["top_stress"])
axes.set(xlabel="compression (%)", ylabel=f"stress on the plate ({result.case.stress_unit})")
figure.savefig("results/band_stress.png")

# %% [markdown]
# The strain since the start, on the deformed shape.

# %%
last = result.snapshots[-1]
figure, axes = plt.subplots(layout="constrained")
drawn = axes.pcolormesh(*last.x.transpose(2, 0, 1), last["strain"], shading="gouraud")
axes.set(aspect="equal", xlabel="$x_1$ (d)", ylabel="$x_2$ (d)", title=last.label)
figure.colorbar(drawn, label="equivalent strain")
figure.savefig("results/band_strain.png")
