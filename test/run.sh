#!/usr/bin/env bash
# Installs what is missing, builds the tests and runs them.
set -euo pipefail
trap 'echo "test/run.sh: stopped at line $LINENO, which is a fault of the script" >&2' ERR
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"

usage() {
  cat <<TEXT
usage: test/run.sh [--quick | --full] [MODULE...]
  (nothing)   the parts by clang with ASan and UBSan; what is put together of them by g++ -O2; TSan for what runs in
              threads; every header alone; consumers
  --quick     the parts by g++ -O2 only: a few minutes
  --full      every module by g++ -O2, clang -O2 and under ASan, the algorithms for AArch64 by qemu; all else of the default;
              fuzzed readers, every benchmark once, the example from end to end
  MODULE        only these modules (folders of test/), by g++ and under ASan, for instance: lie io
environment: CHAINSLAM_BUILD_DIR (default: build/), CHAINSLAM_DATA (a folder of real data), CHAINSLAM_JOBS,
             CHAINSLAM_TEST_SEED (repeat one seed of the property tests)
TEXT
}

mode=default
modules=()
for argument in "$@"; do
  case "$argument" in
    --quick) mode=quick ;;
    --full) mode=full ;;
    -h | --help) usage; exit 0 ;;
    -*) usage >&2; echo "test/run.sh: unknown option $argument" >&2; exit 2 ;;
    *) [ -d "$root/test/$argument" ] || { echo "test/run.sh: no folder test/$argument" >&2; exit 2; }
       modules+=("$argument") ;;
  esac
done
. "$root/third_party/setup.sh"

passed=0 failed=0 skipped=0 failures=()

# start_step NAME COMMAND...: begins a step that is not a doctest program.
start_step() {
  local name="$1" log="$build/logs/${1//[^a-zA-Z0-9_]/_}"
  shift
  rm -f "$log.end"
  {
    local start=$SECONDS status=0
    ("$@") >"$log.log" 2>&1 || status=$?
    echo "$status $((SECONDS - start))" >"$log.part" && mv "$log.part" "$log.end"
  } &
}

# end_step NAME: waits for what start_step began; counts as one test.
end_step() {
  local name="$1" log="$build/logs/${1//[^a-zA-Z0-9_]/_}" status seconds
  until [ -e "$log.end" ]; do sleep 0.2; done
  read -r status seconds <"$log.end"
  if [ "$status" -eq 0 ]; then
    passed=$((passed + 1))
    say "passed" "$name ($seconds s)"
  else
    failed=$((failed + 1))
    failures+=("$name: see $log.log")
    tail -n 40 "$log.log"
    say "FAILED" "$name"
  fi
}

run_step() { start_step "$@" && end_step "$1"; }

suites='*'  # those that run
run_by=()   # what runs them, if not this processor

# run_side_by_side FOLDER MODULE...: as many modules at a time as there are cores. A module's output goes to its log; when it
# has ended, its exit status and seconds stand in the file beside that.
run_side_by_side() {
  local folder="$1" module
  shift
  for module in "$@"; do
    while [ "$(jobs -rp | wc -l)" -ge "$jobs" ]; do wait -n || true; done
    {
      local start=$SECONDS status=0 log="$build/logs/$folder-$module"
      "${run_by[@]}" "$build/$folder/test/test_$module" "--test-suite=$suites" >"$log.log" 2>&1 || status=$?
      echo "$status $((SECONDS - start))" >"$log.part" && mv "$log.part" "$log.end"
    } &
  done
  wait
}

# run_programs FOLDER LABEL MODULE...: runs the modules' doctest programs, the long ones first, and adds up their counts.
run_programs() {
  local folder="$1" label="$2" module log status seconds counts ok bad long="slam program odometry simulator registration"
  local order=()
  shift 2
  for module in $long "$@"; do
    case " $* " in *" $module "*) case " ${order[*]-} " in *" $module "*) ;; *) order+=("$module") ;; esac ;; esac
  done
  for module in "${order[@]}"; do rm -f "$build/logs/$folder-$module".{log,part,end}; done
  run_side_by_side "$folder" "${order[@]}" &
  for module in "${order[@]}"; do
    log="$build/logs/$folder-$module.log"
    until [ -e "${log%.log}.end" ]; do sleep 0.2; done
    read -r status seconds <"${log%.log}.end"
    skipped=$((skipped + $(grep -c '^SKIPPED' "$log" || true)))
    grep '^SKIPPED' "$log" | sed 's/^/             /' || true
    grep '^FIGURE' "$log" | sed 's/^FIGURE/            /' || true
    counts="$(grep -a '^\[doctest\] test cases:' "$log" | grep -oE '[0-9]+ (passed|failed)' | grep -oE '[0-9]+' | tr '\n' ' ')"
    read -r ok bad <<<"${counts:-0 1}"
    if [ "$status" -ne 0 ] && [ "$bad" -eq 0 ]; then bad=1; fi
    passed=$((passed + ok)) failed=$((failed + bad))
    if [ "$bad" -eq 0 ]; then
      say "passed" "$label $module: $ok tests ($seconds s)"
    else
      failures+=("$label $module: see $log; repeat with $build/$folder/test/test_$module")
      { grep -aE -B 5 -A 8 'ERROR|FATAL|Sanitizer' "$log" || tail -n 20 "$log"; } | sed -n 1,60p
      say "FAILED" "$label $module: $bad of $((ok + bad)), exit code $status"
    fi
  done
  wait
}

# slowest FOLDER: the translation units that took longest, so that a heavy one is noticed.
slowest() {
  local log="$build/$1/.ninja_log"
  [ -f "$log" ] || return 0
  awk -F'\t' 'NR > 1 && $4 ~ /\.o$/ { t[$4] = ($2 - $1) / 1000 } END { for (o in t) printf "%.0f %s\n", t[o], o }' "$log" |
    sort -rn | sed -n 1,5p | while read -r time object; do say "" "compiled in $time s: ${object#*CMakeFiles/}"; done
}

# Of what makes the paper's tables (bench/experiments): with --full and by name.
of_experiments="experiments lamm"

# all_modules MODE: a line each.
all_modules() {
  local file module
  for file in "$root"/test/*/*_test.cpp; do basename "$(dirname "$file")"; done | sort -u | while read -r module; do
    [ "$1" != full ] && [[ " $of_experiments " == *" $module "* ]] || echo "$module"
  done
}

# Of the algorithms: what robots' own computers run.
algorithms="cloud core evaluation factor_graph features filter graph io lie odometry registration search sensor slam sparse trajectory"

# What is put together of parts that have modules of their own; test/README.md has the reason for each.
assembled="architecture examples experiments factor_graph lamm lie odometry program registration simulator slam"

# assembled_of MODULE..., parts_of MODULE...: those that are put together of others, and those that are not, a line each.
assembled_of() {
  local module
  for module in "$@"; do case " $assembled " in *" $module "*) echo "$module" ;; esac; done
}
parts_of() {
  local module
  for module in "$@"; do case " $assembled " in *" $module "*) ;; *) echo "$module" ;; esac; done
}

mkdir -p "$build/logs" || fail "cannot write to $build; set CHAINSLAM_BUILD_DIR to a folder that can be written"
# shellcheck disable=SC2086
if [ "$mode" = quick ]; then
  install_packages $packages_build $packages_program $packages_test
else
  install_packages $packages_build $packages_program $packages_test $packages_sanitizers $packages_bench $packages_docs
fi
unpack_data
if [ ${#modules[@]} -eq 0 ]; then
  mapfile -t modules < <(all_modules "$mode")
  selected=all
else
  selected=some
fi
threaded=()
for module in "${modules[@]}"; do
  if grep -q '^ *THREADS_TEST_CASE(' "$root/test/$module"/*_test.cpp; then threaded+=("$module"); fi
done
[ "$mode" = quick ] && export CHAINSLAM_QUICK=1
[ "$mode" = full ] && export CHAINSLAM_FULL=1

# All files of a module are one compilation: what they instantiate alike is compiled once.
unity=(-DCMAKE_UNITY_BUILD=ON -DCMAKE_UNITY_BUILD_BATCH_SIZE=0)
common=("${unity[@]}" -DCMAKE_BUILD_TYPE=Release -DCHAINSLAM_BUILD_BENCH=OFF)
# A module is built once: by g++ what is put together, under the sanitizers the parts, unless all is asked for.
fast=("${modules[@]}") checked=("${modules[@]}")
if [ "$selected" = all ]; then
  case "$mode" in
    quick) mapfile -t fast < <(parts_of "${modules[@]}") ;;
    default) mapfile -t fast < <(assembled_of "${modules[@]}")
             mapfile -t checked < <(parts_of "${modules[@]}") ;;
  esac
fi
# chainslam-mpi is compared with the program: where all that is assembled is built, and with the module of its tasks by name.
with_mpi=no mpi_targets="" mpi_options=()
if [ "$mode" != quick ] && { [ "$selected" = all ] || [[ " ${modules[*]} " == *" tasks "* ]]; }; then
  # shellcheck disable=SC2086
  install_packages $packages_mpi
  with_mpi=yes mpi_targets=" chainslam_program chainslam_mpi" mpi_options=(-DCHAINSLAM_MPI=ON)
fi
# As users build it. Eigen's assertions would take a fifth of g++'s time: they are on under the sanitizers.
configure_and_build gcc "g++, -O2" "${fast[*]/#/test_}$mpi_targets" "${common[@]}" \
  "-DCMAKE_CXX_FLAGS_RELEASE=-O2 -DNDEBUG" -DCMAKE_CXX_COMPILER=g++ -DCHAINSLAM_COMPILED=ON \
  ${mpi_options[@]+"${mpi_options[@]}"}
slowest gcc
run_programs gcc "g++" "${fast[@]}"
if [ "$with_mpi" = yes ]; then
  full=()
  [ "$mode" = default ] && [ "$selected" = all ] || full=(--full)
  run_step "maps of several processes are the program's" "$root/test/mpi/run.sh" "$build/gcc/examples" ${full[@]+"${full[@]}"}
fi
if [ "$mode" != quick ] && [ "$selected" = all ]; then
  run_step "no value of a preset changes unnoticed" "$root/test/presets_survivors.sh" \
    "$build/gcc/test/test_program" "$build/gcc/examples/chainslam"
fi

if [ "$mode" != quick ]; then
  # Assertions stay on under the sanitizers. Line numbers in stacks would take a fifth of the compile time: -O1 -g1 where
  # one is to be looked at. An assertion that throws names its test alone, not its line: that is g++'s to say, and a catch
  # around each takes another fifth.
  sanitized=("${unity[@]}" -DCMAKE_BUILD_TYPE=Sanitized -DCHAINSLAM_BUILD_BENCH=OFF
             "-DCMAKE_CXX_FLAGS_SANITIZED=-O1 -DDOCTEST_CONFIG_NO_TRY_CATCH_IN_ASSERTS"
             -DCMAKE_CXX_COMPILER=clang++-14)
  # The long runs stay with the fast build of the same module.
  [ "$mode" = default ] && [ "$selected" = all ] || export CHAINSLAM_QUICK=1
  configure_and_build asan "clang, ASan + UBSan" "${checked[*]/#/test_}" "${sanitized[@]}" -DCHAINSLAM_SANITIZE=address
  run_programs asan "ASan" "${checked[@]}"
  export CHAINSLAM_QUICK=1
  if [ ${#threaded[@]} -gt 0 ]; then
    configure_and_build tsan "clang, TSan" "${threaded[*]/#/test_}" "${sanitized[@]}" -DCHAINSLAM_SANITIZE=thread
    suites='threads: *'
    run_programs tsan "TSan" "${threaded[@]}"
    suites='*'
  fi
  if [ "$selected" = all ]; then
    seam_compilers=clang++-14
    [ "$mode" = full ] && seam_compilers="g++ clang++-14"
    consumers=("$build/consumer" --library "$build/gcc")
    [ "$mode" = full ] && consumers+=(--all)
    header_check=("$root/test/headers.sh")
    [ "$mode" = full ] && header_check+=(--all)
    # Two at a time: each leaves a core idle for half of its time.
    start_step "errors at the concepts can be read" env CXX="$seam_compilers" "$root/test/compile_fail/run.sh" "$root/include"
    start_step "consumers build" env CXX=g++ "$root/test/consumer/run.sh" "${consumers[@]}"
    end_step "errors at the concepts can be read"
    if [ "$mode" = full ]; then
      end_step "consumers build"
      run_step "programs of users compile in time" "$root/test/compile_times.sh" --check
      run_step "compiled programs of users compile in time" "$root/test/compile_times.sh" --check --compiled
    else
      start_step "programs of users compile in time" env CXX=g++ "$root/test/compile_times.sh" --check \
        ikd_tree icp smoother lidar_inertial_odometry
      end_step "consumers build"
      end_step "programs of users compile in time"
    fi
    run_step "every header compiles alone" "${header_check[@]}" "$root/include"
    run_step "programs of the modules' pages compile" env CXX=clang++-14 "$root/test/module_pages/run.sh" "$root/include"
    run_step "the API reference is built" cmake --build "$build/gcc" --target docs
  fi
fi
if [[ " ${modules[*]} " == *" experiments "* ]]; then
  # shellcheck disable=SC2086
  install_packages $packages_experiments
  run_step "scripts of the experiments" env PYTHONPATH="$root/bench" PYTHONDONTWRITEBYTECODE=1 \
    "$(debian_python)" -m unittest discover -s "$root/test/experiments" -p '*_test.py'
fi
if [ "$mode" = full ]; then
  unset CHAINSLAM_QUICK
  configure_and_build clang "clang, -O2" "${modules[*]/#/test_}" "${common[@]}" -DCMAKE_CXX_FLAGS_RELEASE=-O2 \
    -DCMAKE_CXX_COMPILER=clang++-14
  run_programs clang "clang" "${modules[@]}"
  if [ "$selected" = all ]; then  # from what the tests have written
    # Coverage is printed by function, which takes line tables.
    configure_and_build fuzz "clang, libFuzzer" fuzzers "-DCMAKE_CXX_FLAGS_SANITIZED=-O1 -gline-tables-only" \
      -DCMAKE_BUILD_TYPE=Sanitized -DCMAKE_CXX_COMPILER=clang++-14 -DCHAINSLAM_SANITIZE=address \
      -DCHAINSLAM_BUILD_FUZZERS=ON -DCHAINSLAM_BUILD_TESTS=OFF -DCHAINSLAM_BUILD_BENCH=OFF -DCHAINSLAM_BUILD_EXAMPLES=OFF
    run_step "readers withstand what is made up" "$root/test/fuzz/run.sh" "$build/fuzz/test/fuzz" "$build/gcc/test" 10
  fi
  if [ "$selected" = all ] && [ "$(uname -m)" = x86_64 ]; then  # on AArch64 all of the above is of AArch64
    # shellcheck disable=SC2086
    {
      install_packages $packages_aarch64
      unpack_foreign_packages "$build/arm64" arm64 $packages_arm64
    }
    read -ra emulated <<<"$algorithms"
    configure_and_build aarch64 "g++ for AArch64, -O2" "${emulated[*]/#/test_} chainslam_program" "${common[@]}" \
      "-DCMAKE_CXX_FLAGS_RELEASE=-O2 -DNDEBUG" -DCHAINSLAM_COMPILED=ON "-DCHAINSLAM_SYSROOT=$build/arm64" \
      "-DCMAKE_TOOLCHAIN_FILE=$root/third_party/aarch64.cmake"
    # The long runs stay with the processor that there is.
    export CHAINSLAM_QUICK=1
    run_by=(qemu-aarch64 -L "$build/arm64")
    run_programs aarch64 "AArch64" "${emulated[@]}"
    run_by=()
    unset CHAINSLAM_QUICK
    run_step "AArch64 computes what x86-64 does" "$root/test/aarch64/run.sh" "$build/aarch64_results" "$build/gcc" \
      "$build/aarch64" "$build/arm64"
  fi
  run_step "every benchmark runs" "$root/bench/run.sh" --smoke
  run_step "the table of odometries is written" "$root/bench/odometry_table.sh" --only nuscenes_scene
  run_step "the example runs from end to end" "$root/test/examples/end_to_end.sh"
  run_step "the report works in a browser" "$root/test/report/run.sh" "$build/release/examples/chainslam"
  run_step "the paper's tables are made of small worlds" "$root/bench/experiments/run.sh" --size small
fi

for failure in ${failures[@]+"${failures[@]}"}; do say "FAILED" "$failure"; done
# What the machine's other work takes counts in the one, not in the other.
times >"$build/logs/processor_time"
say "time" "$((SECONDS / 60)) min $((SECONDS % 60)) s, $(awk 'NR == 2 {
  for (i = 1; i <= 2; ++i) { split($i, part, /[ms]/); s += 60 * part[1] + part[2] } printf "%.0f", s / 60 }' \
  "$build/logs/processor_time") min of processor time on $(nproc) cores"
echo "tests: $passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ] && [ "$passed" -gt 0 ]
