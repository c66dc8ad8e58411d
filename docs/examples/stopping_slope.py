# %% [markdown]
# # Stopping height on a slope
# A layer on a slope flows if it is thicker than H_stop, which is known analytically for
# dynamic NGF. Two runs, with a thicker and a thinner layer, confirm it.

# %%
import pgran
from pgran import cases
from pgran.theory import profiles

slope = 26
case = cases.create(cases.read({"pgran_case": "inclined_plane", "pgran_law": "jop",
                                "pgran_slope": str(slope)}))
stop = profiles.stopping_height(case.law, case.parameters.A, slope)
print(f"H_stop = {stop:.2f} d at {slope} degrees")

# %%
for share in (1.3, 0.9):
    height = share * stop
    result = pgran.run(f"results/slope_{share}.h5", case="inclined_plane", slope=slope,
                       model="ngf_primitive", height=height, element_size=height / 16,
                       width=height / 8)
    speed = result.snapshots[-1]["speed"].max()
    print(f"{share:.1f} H_stop: the surface moves at {speed:.2e} d gdot0")
