#!/usr/bin/env bash
# Write a batch script for Slurm or PBS from one template, with its budget in the header.
#
#   bash jobs/cluster.sh slurm|pbs run     RANKS FILE.opts [options of pgran]
#   bash jobs/cluster.sh slurm|pbs chain   RANKS FILE.opts [options of pgran]
#   bash jobs/cluster.sh slurm|pbs sweep   RANKS SCRIPT.py POINTS HOURS MEMORY_GB
#   bash jobs/cluster.sh slurm|pbs scaling RANKS
#   bash jobs/cluster.sh slurm|pbs job     RANKS HOURS MEMORY_GB jobs/NAME.sh [arguments]
#
# run is one run. chain asks to be queued again before its time ends, as often as it needs, and goes
# on from its last checkpoint: the answer is that of one long run. sweep is a job array over the
# points of a script that calls pgran.sweep (docs/examples/sweep.py). scaling is
# jobs/study.sh bench weak on 1, 2, 4, ... ranks. job is any script of jobs/.
#
# The script is written to the present folder: pgran-KIND-NAME.slurm or pgran-KIND-NAME.pbs, where NAME
# is that of the result file, or of SCRIPT.py or jobs/NAME.sh. The result file of run and chain is
# -pgran_output, of the options or of FILE.opts, or results/FILE.h5. A script of another result is not
# overwritten. Time and memory of run and chain are twice what pgran.budget estimates. PGRAN_TIME (HH:MM:SS) and PGRAN_MEMORY (GB)
# take their place, and PGRAN_MARGIN seconds (a twentieth of the time, at least 60) are left to write
# the last checkpoint.
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
[[ $system == slurm || $system == pbs ]] || usage "$system: allowed is slurm | pbs"
[[ $ranks =~ ^[1-9][0-9]*$ ]] || usage "$ranks: allowed is a number of ranks"

estimate() {  # hours, memory and result file of a run with an options file and options
    local line
    line=$(PYTHONPATH="$home" "$python" -m pgran.budget -options_file "$1" -ranks "$ranks" "${@:2}") \
        || return 1
    echo "${line%%$'\n'*}" >&2
    sed -n 's/^# Budget: [0-9]* ranks, \([0-9]*\) hours, \([0-9]*\) GB$/\1 \2/p;
            s/^# Output: //p' <<< "$line" | paste -sd " "
}

hours=1 memory=$((2 * ranks)) array="" output="" name=pgran-$kind
case $kind in
    run | chain)
        (($#)) || usage "$kind: FILE.opts is missing"
        found=$(estimate "$@")
        read -r hours memory output <<< "$found"
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
        (($# == 4)) || usage "sweep: SCRIPT.py POINTS HOURS MEMORY_GB are needed"
        [[ $2 =~ ^[1-9][0-9]*$ ]] || usage "$2: allowed is a number of points"
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
        (($# >= 3)) || usage "job: HOURS MEMORY_GB jobs/NAME.sh are needed"
        hours=$1 memory=$2 name+=-$(basename "$3" .sh)
        [[ $3 != */study.sh ]] || name+=-${*:4:2}
        printf -v body ' %q' "${@:3}"
        body="bash$body"
        ;;
    *) usage "$kind: allowed is run | chain | sweep | scaling | job" ;;
esac
[[ $hours =~ ^[1-9][0-9]*$ && $memory =~ ^[1-9][0-9]*$ ]] \
    || usage "$hours hours and $memory GB: allowed are whole numbers"
printf -v clock '%02d:00:00' "$hours"
clock=${PGRAN_TIME:-$clock} memory=${PGRAN_MEMORY:-$memory}
[[ $clock =~ ^([0-9]+):([0-9]{2}):([0-9]{2})$ ]] || usage "PGRAN_TIME $clock: allowed is HH:MM:SS"
seconds=$((10#${BASH_REMATCH[1]} * 3600 + 10#${BASH_REMATCH[2]} * 60 + 10#${BASH_REMATCH[3]}))
margin=${PGRAN_MARGIN:-$((seconds / 20 > 60 ? seconds / 20 : 60))}
((margin < seconds)) || usage "PGRAN_MARGIN $margin: allowed are fewer seconds than $clock has"
name=${name//[^A-Za-z0-9._-]/_} file=$name.$system made="# Result: ${output:-of the script}"
[[ ! -e $file ]] || grep -qxF "$made" "$file" \
    || usage "$file: it is there and writes another result; rename or remove it first"

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
    # 75 is the exit code of a run that was asked to stop and can go on. timeout asks it in time.
    body="code=0
timeout --preserve-status --signal=USR1 $((seconds - margin)) $body || code=\$?
if ((code == 75)); then
    echo \"pgran: the time is up; queued again\"
    $again
    exit 0
fi
exit \"\$code\""
else
    body="exec $body"
fi

cat > "$file" <<TEMPLATE
#!/usr/bin/env bash
# pgran: $kind, from the repository. Made by jobs/cluster.sh; change that.
#
# Budget: $ranks ranks, $clock hours, $memory GB.
$made
# PGRAN_PYTHON is the Python that has petsc4py and pgran; PGRAN_LAUNCH starts the ranks.
$directives
set -euo pipefail
cd "$folder"
export PGRAN_PYTHON="\${PGRAN_PYTHON:-$python}" PGRAN_RANKS=$ranks
export PGRAN_LAUNCH=\${PGRAN_LAUNCH:-$launch}
$body
TEMPLATE
echo "$file"
