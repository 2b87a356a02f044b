#!/usr/bin/env bash
# usage: test/fuzz/run.sh FUZZERS TESTS SECONDS [NAME...]
# Runs the fuzzers in the folder FUZZERS, or those of these names, for so many seconds each: from the files that the tests
# in the folder TESTS write, and from test/fuzz/corpus. CHAINSLAM_FUZZ_EXECUTIONS ends each after so many inputs, if that is
# sooner. Prints each one's executions per second of processor time, which other programs' work does not change, and how much
# of our code that it entered it covers. Input that finds a fault is left in FUZZERS.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
cd "$1"
tests="$2" seconds="$3"
shift 3
seeds_of_tests="$PWD/seeds"
for test in datasets io; do
  [ -d "$seeds_of_tests/$test" ] && continue
  CHAINSLAM_FIXTURES="$seeds_of_tests/$test" CHAINSLAM_QUICK=1 "$tests/test_$test" >/dev/null
done
export UBSAN_OPTIONS=print_stacktrace=1
# Files that are written and read for each input, in memory where there is such a place.
[ -w /dev/shm ] && export TMPDIR=/dev/shm

# summary NAME LOG FOLDER...: of the run, and of the inputs in the folders.
summary() {
  local name="$1" units seconds rate edges
  units="$(sed -n 's/^stat::number_of_executed_units: *//p' "$2")"
  seconds="$(awk '{ printf "%.1f", $1 + $2 }' "$2.times")"
  rate="$(awk -v units="${units:-0}" -v seconds="$seconds" 'BEGIN { printf "%.0f", units / (seconds > 0 ? seconds : 1) }')"
  shift 2
  edges="$("./fuzz_$name" -runs=0 -max_len=65536 -print_coverage=1 "$@" 2>&1 |
    awk '/^COVERED_FUNC:.* chainslam::/ { split($5, part, "/"); covered += part[1]; all += part[2]; ++functions }
         END { if (all > 0) printf "%.0f %% of %d edges in %d functions", 100 * covered / all, all, functions }')"
  printf '%-22s %6s executions/s in %s s of processor time, %s in all, covers %s\n' \
    "$name" "$rate" "$seconds" "${units:-0}" "$edges"
  if [ "${rate:-0}" -lt 1000 ]; then echo "             slow: fewer than 1000 executions/s"; fi
}

for program in ./fuzz_*; do
  [ -x "$program" ] && [ -f "$program" ] || continue
  name="${program#./fuzz_}"
  case " ${*:-$name} " in *" $name "*) ;; *) continue ;; esac
  case "$name" in
    nclt_hits | nclt_sync | helipr | kitti) kind=bin ;;
    kitti_poses | stamps | extrinsic | kitti_calibration) kind=txt ;;
    map_chunks) kind=cslam ;;
    input_journal) kind=partial ;;
    program_trajectory) kind=tum ;;
    euroc) kind=csv ;;
    range_image_geometry) kind=cfg ;;
    *) kind="$name" ;;
  esac
  longest=65536  # bytes of an input
  [ "$name" = db3 ] && longest=8192  # pages of which are read again and again
  seeds="$seeds_of_tests/datasets/$kind" more="$seeds_of_tests/io/$kind"
  mkdir -p "corpus_$name" "$seeds" "$more"
  folders=("corpus_$name" "$seeds" "$more")
  if [ -d "$here/corpus/$name" ]; then folders+=("$here/corpus/$name"); fi
  TIMEFORMAT='%U %S'
  { time "$program" -max_total_time="$seconds" -runs="${CHAINSLAM_FUZZ_EXECUTIONS:--1}" -max_len="$longest" \
    -rss_limit_mb=1500 -malloc_limit_mb=512 -timeout=10 -artifact_prefix="found_${name}_" \
    -print_final_stats=1 -verbosity=0 "${folders[@]}" >"log_$name" 2>&1; } \
    2>"log_$name.times" || { tail -n 60 "log_$name"; exit 1; }
  summary "$name" "log_$name" "${folders[@]}"
done
