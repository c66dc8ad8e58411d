#!/usr/bin/env bash
# Write a batch script for Slurm or PBS.
#
#   bash jobs/cluster.sh slurm|pbs run     RANKS FILE.opts [options of pgran]
#   bash jobs/cluster.sh slurm|pbs chain   RANKS FILE.opts [options of pgran]
#   bash jobs/cluster.sh slurm|pbs sweep   RANKS SCRIPT.py POINTS HOURS MEMORY_GB
#   bash jobs/cluster.sh slurm|pbs scaling RANKS
#   bash jobs/cluster.sh slurm|pbs job     RANKS HOURS MEMORY_GB jobs/NAME.sh [arguments]
#
# run is one run. chain is a run that is queued again before its time ends, as often as necessary,
# and resumes from its last checkpoint. sweep is a job array over the points of a script that calls
# pgran.sweep (docs/examples/sweep.py). scaling is `study.sh bench weak` on 1, 2, 4, ...
# ranks. job is any script of jobs/.
#
# The script is pgran-KIND-NAME.slurm or pgran-KIND-NAME.pbs in the current directory, where NAME is
# the name of the result file, of SCRIPT.py or of jobs/NAME.sh. The result file of run and chain is
# -pgran_output, of the options or of FILE.opts, or results/FILE.h5. An existing script of another
# result is not overwritten.
#
# PGRAN_TIME (HH:MM:SS) is the time limit; the default of run and chain is 24:00:00. PGRAN_MEMORY is
# the memory in GB; the default of run and chain is 2.3 kB per unknown with multigrid, 5.6 kB with
# MUMPS, plus 150 MB per rank. PGRAN_MARGIN is the time for the last checkpoint in seconds (default:
# a twentieth of the time limit, at least 60).
set -euo pipefail
home="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
python=${PGRAN_PYTHON:-$home/.venv/bin/python}
[[ -x $python ]] || python=$(command -v python3)

usage() {
    sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//p}' "${BASH_SOURCE[0]}"
    [[ -z ${1:-} ]] || echo "jobs/cluster.sh: error: $1" >&2
    exit 1
}

(($# >= 3)) || usage
system=$1 kind=$2 ranks=$3
shift 3
[[ $system == slurm || $system == pbs ]] || usage "$system: expected slurm or pbs"
[[ $ranks =~ ^[1-9][0-9]*$ ]] || usage "$ranks: RANKS must be an integer > 0"

estimate() {  # memory in GB and result file of a run: FILE.opts [options]
    PYTHONPATH="$home" "$python" - "$ranks" "$@" <<'PYTHON'
import sys

from pgran import cases
from pgran.options import OptionError, ParameterError
from pgran.runs.run_on_ranks import combined_options

try:
    texts = combined_options(*sys.argv[2:])
    case = cases.create(cases.read(texts))
except (OptionError, ParameterError) as error:
    sys.exit(f"jobs/cluster.sh: error: {error}")
size = 2.3e3 if texts.get("pc_type") == "fieldsplit" else 5.6e3
print(int((size * case.unknowns + 150e6 * int(sys.argv[1])) / 1e9) + 1, case.parameters.output)
PYTHON
}

hours=1 memory=$((2 * ranks)) array="" output="" name=pgran-$kind
case $kind in
    run | chain)
        (($#)) || usage "$kind: FILE.opts is missing"
        found=$(estimate "$@")
        hours=24
        read -r memory output <<< "$found"
        [[ $output != results/pgran.h5 ]] || output=results/$(basename "$1" .opts).h5
        options=()
        for ((n = 1; n <= $#; n++)); do
            if [[ ${!n} == -pgran_output ]]; then n=$((n + 1)); else options+=("${!n}"); fi
        done
        name+=-$(basename "$output" .h5)
        printf -v body ' %q' "$output" "${options[@]}"
        body="\"\$PGRAN_PYTHON\" -m pgran.runs.run_on_ranks$body"
        ;;
    sweep)
        (($# == 4)) || usage "sweep: SCRIPT.py POINTS HOURS MEMORY_GB are required"
        [[ $2 =~ ^[1-9][0-9]*$ ]] || usage "$2: POINTS must be an integer > 0"
        hours=$3 memory=$4 array="0-$(($2 - 1))" name+=-$(basename "$1" .py)
        printf -v body '%q' "$1"
        body="\"\$PGRAN_PYTHON\" $body"
        ;;
    scaling)
        list="" count=1
        while ((count <= ranks)); do list+="$count " count=$((2 * count)); done
        body="bash jobs/study.sh bench weak \"${list% }\""
        ;;
    job)
        (($# >= 3)) || usage "job: HOURS MEMORY_GB jobs/NAME.sh are required"
        hours=$1 memory=$2 name+=-$(basename "$3" .sh)
        [[ $3 != */study.sh ]] || name+=-${*:4:2}
        printf -v body ' %q' "${@:3}"
        body="bash$body"
        ;;
    *) usage "$kind: expected run, chain, sweep, scaling or job" ;;
esac
[[ $hours =~ ^[1-9][0-9]*$ && $memory =~ ^[1-9][0-9]*$ ]] \
    || usage "$hours, $memory: HOURS and MEMORY_GB must be integers > 0"
printf -v clock '%02d:00:00' "$hours"
clock=${PGRAN_TIME:-$clock} memory=${PGRAN_MEMORY:-$memory}
[[ $clock =~ ^([0-9]+):([0-9]{2}):([0-9]{2})$ ]] || usage "PGRAN_TIME $clock: expected HH:MM:SS"
seconds=$((10#${BASH_REMATCH[1]} * 3600 + 10#${BASH_REMATCH[2]} * 60 + 10#${BASH_REMATCH[3]}))
margin=${PGRAN_MARGIN:-$((seconds / 20 > 60 ? seconds / 20 : 60))}
((margin < seconds)) || usage "PGRAN_MARGIN $margin: must be less than the time limit $clock"
name=${name//[^A-Za-z0-9._-]/_} file=$name.$system made="# Result: ${output:-see the script}"
[[ ! -e $file ]] || grep -qxF "$made" "$file" \
    || usage "$file: exists and writes another result; rename or remove it first"

if [[ $system == slurm ]]; then
    directives="#SBATCH --job-name=$name
#SBATCH --ntasks=$ranks
#SBATCH --time=$clock
#SBATCH --mem=${memory}G
#SBATCH --output=$name-%j.log
#SBATCH --open-mode=append"
    [[ -z $array ]] || directives=${directives/-%j.log/-%A_%a.log}$'\n'"#SBATCH --array=$array"
    # shellcheck disable=SC2016  # the batch script expands these
    folder='$SLURM_SUBMIT_DIR' again='scontrol requeue "$SLURM_JOB_ID"' launch=srun
    [[ $kind != chain ]] || directives+=$'\n#SBATCH --requeue'
else
    directives="#PBS -N $name
#PBS -l select=1:ncpus=$ranks:mpiprocs=$ranks:mem=${memory}gb
#PBS -l walltime=$clock
#PBS -j oe"
    [[ -z $array ]] || directives+=$'\n'"#PBS -J $array"
    # shellcheck disable=SC2016
    folder='$PBS_O_WORKDIR' again="qsub $file" launch="mpiexec -n $ranks"
fi

if [[ $kind == chain ]]; then
    # A run that was stopped by a signal and can be resumed has the exit code 75.
    body="code=0
timeout --preserve-status --signal=USR1 $((seconds - margin)) $body || code=\$?
if ((code == 75)); then
    echo \"pgran: time limit reached; queued again\"
    $again
    exit 0
fi
exit \"\$code\""
else
    body="exec $body"
fi

cat > "$file" <<TEMPLATE
#!/usr/bin/env bash
# pgran: $kind. Written by jobs/cluster.sh.
#
# Budget: $ranks ranks, $clock hours, $memory GB.
$made
# PGRAN_PYTHON is the Python with petsc4py and pgran. PGRAN_LAUNCH starts the ranks.
$directives
set -euo pipefail
cd "$folder"
export PGRAN_PYTHON="\${PGRAN_PYTHON:-$python}" PGRAN_RANKS=$ranks
export PGRAN_LAUNCH=\${PGRAN_LAUNCH:-$launch}
$body
TEMPLATE
echo "$file"
