#!/usr/bin/env bash
# Maps drives with several processes on one machine, and compares each map with that of the plain program, byte by byte:
# for any number of processes, where processes are killed, and where a job ended and is started again.
#
# usage: test/mpi/run.sh FOLDER [--full]
#   FOLDER has the programs chainslam and chainslam-mpi, built with -DCHAINSLAM_MPI=ON
#   --full: 1, 2 and 4 processes, processes and jobs that are killed, Ctrl-C; else 2 processes
set -euo pipefail
[ $# -ge 1 ] || { sed -n '5,7s/^# //p' "$0" >&2; exit 2; }
programs="$(cd "$1" && pwd)"
mode="${2:-}"
scratch="$(mktemp -d)"
trap 'rm -rf "$scratch"' EXIT
cd "$scratch"
if [ "$(id -u)" -eq 0 ]; then export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1; fi
export OMPI_MCA_odls_base_sigkill_timeout=3  # seconds from Ctrl-C to SIGTERM, and from there to SIGKILL

say() { printf '%-12s %s\n' "$1" "$2"; }
fail() {
  say "FAILED" "$1"
  [ ! -f "${2:-}" ] || tail -n 20 "$2"
  exit 1
}

scans=(--max-scans "${CHAINSLAM_MPI_SCANS:-150}" --threads 1)
drives=(simulate:town-sessions/small/{1,2,3})
"$programs/chainslam" map "${drives[@]}" "${scans[@]}" --out plain >plain.log 2>&1 || fail "the plain program" plain.log
bytes="$(stat -c %s plain/map.cslam)"
[ "$bytes" -gt 100000 ] || fail "the plain map has $bytes bytes only: it shows nothing"

# job NAME PROCESSES MPIRUN-ARGUMENT... : starts a job that maps the drives into NAME; its number is in $job.
job() {
  local name="$1" processes="$2"
  shift 2
  mpirun --oversubscribe --bind-to none "$@" -n "$processes" "$programs/chainslam-mpi" map "${drives[@]}" "${scans[@]}" \
    --out "$name" >"$name.log" 2>&1 &
  job=$!
}

# same NAME EXIT-CODE: the job's map is the plain program's, and nothing else is left.
same() {
  [ "$2" -eq 0 ] || fail "$1: exit code $2" "$1.log"
  cmp plain/map.cslam "$1/map.cslam" || fail "$1: another map" "$1.log"
  [ ! -e "$1.sessions" ] || fail "$1: $1.sessions is left" "$1.log"
}

# await NAME SECONDS COMMAND...: until the command succeeds.
await() {
  local name="$1" seconds="$2" end
  shift 2
  end=$((SECONDS + seconds))
  until "$@" 2>/dev/null; do
    [ "$SECONDS" -lt "$end" ] || fail "$name: waited $seconds s for: $*" "$name.log"
    sleep 0.1
  done
}

# worker RANK: prints the process of a rank of the job; child_of RANK: prints that of its task.
worker() {
  local pid
  for pid in $(pgrep -P "$job"); do
    if tr '\0' '\n' <"/proc/$pid/environ" | grep -qx "OMPI_COMM_WORLD_RANK=$1"; then echo "$pid"; return 0; fi
  done
  return 1
}
child_of() { pgrep -P "$(worker "$1")" chainslam-mpi; }

# What the program prints of scans, IMU, keyframes, sessions, closures and errors.
figures() { grep -E '^(scans|IMU|keyframes|sessions|closures|error|goal|  ) ' "$1.log"; }

numbers="2"
[ "$mode" != --full ] || numbers="1 2 4"
for n in $numbers; do
  start=$SECONDS status=0
  job "ranks$n" "$n"
  wait "$job" || status=$?
  same "ranks$n" "$status"
  [ "$(figures plain)" = "$(figures "ranks$n")" ] || fail "$n processes: other figures of the sessions"
  say "passed" "$n processes: the plain program's map of $bytes bytes ($((SECONDS - start)) s)"
done
[ "$mode" = --full ] || exit 0

status=0
job killed_rank 3 --enable-recovery
await killed_rank 120 child_of 1
kill -KILL "$(worker 1)"
wait "$job" || status=$?
same killed_rank "$status"
grep -q "process 1 does not answer: its task is done again" killed_rank.log || fail "no word of the killed process" killed_rank.log
say "passed" "a killed process costs its task"

status=0
job killed_task 2
await killed_task 120 child_of 1
kill -KILL "$(child_of 1)"
wait "$job" || status=$?
same killed_task "$status"
say "passed" "a task whose process is killed is done again"

job killed_job 2
await killed_job 300 eval 'ls killed_job.sessions/*-????????????????/result.json'
ranks="$(worker 0) $(worker 1)"
kill -KILL "$job" $ranks
wait "$job" 2>/dev/null || true
await killed_job 60 eval "! pgrep -f '$programs/chainslam-mpi --do-task'"
[ ! -e killed_job ] || fail "the job was killed too late" killed_job.log
status=0
job killed_job 2
wait "$job" || status=$?
same killed_job "$status"
grep -q "sessions is there from a run before" killed_job.log || fail "the odometry was not used again" killed_job.log
say "passed" "a job that was killed continues"

status=0
job interrupted 2
await interrupted 300 eval 'ls interrupted.sessions/*-????????????????/result.json'
kill -INT "$job"
wait "$job" || status=$?
[ "$status" -ne 0 ] || fail "an interrupted job ends with exit code 0" interrupted.log
await interrupted 60 eval "! pgrep -f '$programs/chainslam-mpi --do-task'"
[ -d interrupted.sessions ] || fail "the sessions of an interrupted job are gone" interrupted.log
if ls interrupted.sessions/*.partial* 2>/dev/null; then fail "an incomplete recording is left" interrupted.log; fi
status=0
rm -rf interrupted
job interrupted 2
wait "$job" || status=$?
same interrupted "$status"
say "passed" "a job that was interrupted continues"
