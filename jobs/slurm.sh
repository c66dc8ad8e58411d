#!/usr/bin/env bash
# Write the Slurm scripts jobs/NAME.slurm from the one template below.
#
#   bash jobs/slurm.sh [NAME ...: fig6 fig7]
#
# Budgets leave room: four times the time and three times the memory that were measured on two ranks
# of a two-core machine (docs/reproduction.md). More ranks need more memory, MUMPS most of all.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

budget() {  # budget NAME: what it is about, what it takes, and what was measured
    ranks=8 nodes=1 sizes="2 1 0.5 0.25"
    case $1 in
        fig6) title="Figure 6" hours=2 memory=12 measured="28 minutes, d/4 942 s and 4.3 GB" ;;
        fig7) title="Figure 7" hours=4 memory=16 measured="48 minutes, d/4 2413 s and 4.1 GB" ;;
        *) echo "jobs/slurm.sh: error: $1: allowed is fig6 | fig7" >&2; exit 1 ;;
    esac
}

(($#)) || set -- fig6 fig7
for name in "$@"; do
    budget "$name"
    cat > "$name.slurm" <<TEMPLATE
#!/usr/bin/env bash
# $title on a cluster, from the repository: sbatch jobs/$name.slurm [element sizes: "$sizes"]
#
# Budget: $nodes node, $ranks ranks, $hours hours, $memory GB. On 2 ranks it took $measured.
# PGRAN_PYTHON is the Python that has petsc4py, slepc4py and h5py with MPI, and PGRAN_LAUNCH (srun)
# starts the ranks. Made by jobs/slurm.sh; change that.
#SBATCH --job-name=pgran-$name
#SBATCH --nodes=$nodes
#SBATCH --ntasks=$ranks
#SBATCH --time=$(printf '%02d' "$hours"):00:00
#SBATCH --mem=${memory}G
#SBATCH --output=$name-%j.log
set -euo pipefail
cd "\$SLURM_SUBMIT_DIR"
export PGRAN_PYTHON=\${PGRAN_PYTHON:-\$(command -v python3)} PGRAN_LAUNCH=\${PGRAN_LAUNCH:-srun}
export PGRAN_RANKS=\${SLURM_NTASKS:-$ranks}
exec bash jobs/$name.sh "\${1:-$sizes}"
TEMPLATE
done
