# %% [markdown]
# # A sweep
# One run per target inertial number: two at a time here, and one per task of a job array on a
# cluster (`bash jobs/cluster.sh slurm sweep 1 docs/examples/sweep.py 4 1 2`). Completed runs are
# reused.

# %%
import pgran

sweep = pgran.sweep({"inertial_number": [0.001, 0.003, 0.007, 0.03]},
                    directory="results/sweep", workers=2, compression=0.05, snapshots=[0.05])
print(sweep)

# %% [markdown]
# `sweep.to_pandas()` returns the table as a pandas data frame, and `sweep[0]` is the first result.

# %%
for row in sweep.rows():
    if row["complete"]:
        print(f"I0 = {row['inertial_number']}: "
              f"{'localised' if row['localised'] else 'not localised'}")
