#!/usr/bin/env bash
# usage: test/fuzz/run.sh FUZZERS TESTS SECONDS
# Runs every fuzzer in the folder FUZZERS for so many seconds, from the files that the tests in the folder TESTS write.
# Input that finds a fault is left in FUZZERS.
set -euo pipefail
cd "$1"
seeds_of_tests="$PWD/seeds"
for test in datasets io; do
  [ -d "$seeds_of_tests/$test" ] && continue
  CHAINSLAM_FIXTURES="$seeds_of_tests/$test" CHAINSLAM_QUICK=1 "$2/test_$test" >/dev/null
done
export UBSAN_OPTIONS=print_stacktrace=1
for program in ./fuzz_*; do
  [ -x "$program" ] && [ -f "$program" ] || continue
  name="${program#./fuzz_}"
  case "$name" in nclt_hits | nclt_sync | helipr | kitti) kind=bin ;; *) kind="$name" ;; esac
  seeds="$seeds_of_tests/datasets/$kind" more="$seeds_of_tests/io/$kind"
  mkdir -p "corpus_$name" "$seeds" "$more"
  "$program" -max_total_time="$3" -rss_limit_mb=1500 -timeout=10 -max_len=65536 -artifact_prefix="found_${name}_" \
    -print_final_stats=1 -verbosity=0 "corpus_$name" "$seeds" "$more"
done
