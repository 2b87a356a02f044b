#!/usr/bin/env bash
# Installs what is missing, builds the benches and runs them.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"

usage() {
  cat <<TEXT
usage: bench/run.sh [--json FILE] [--table FILE] [--peers] [--peer NAME=PATH]... [--no-plain] [--seconds S]
                    [--smoke] [FILTER]
  --json FILE   write Google Benchmark's JSON to FILE (all modules in one)
  --table FILE  write the figures to FILE as Markdown, a table for each module
  --peers       install PCL, Open3D and Ceres from Debian and build the comparisons with them
  --peer NAME=PATH
                build the comparison with sources that Debian does not have; PATH is their root, NAME one of
                ikd_tree, i_octree, nanoflann (1.12 or later; all three in module search), small_gicp,
                kiss_matcher (needs robin, xenium and pmc, too), teaser (needs pmc, too);
                gtsam: where it is installed, compiled with -O3 -march=native, without TBB
  --no-plain    leave out the second column, compiled for plain x86-64
  --seconds S   measure each bench for so long at least (default: 0.5); peers' time comes on top
  --smoke       each bench once, briefly: do they run?
  FILTER        a regular expression on names, for instance 'search/kd_tree'
environment: CHAINSLAM_BUILD_DIR (default: build/), CHAINSLAM_DATA, CHAINSLAM_JOBS
TEXT
}

. "$root/third_party/setup.sh"
command="bench/run.sh"
for argument in "$@"; do
  case "$argument" in *[!A-Za-z0-9_=./:,-]*) command="$command '$argument'" ;; *) command="$command $argument" ;; esac
done
json="" table="" peers=OFF plain=yes minimum_time=0.5 filter=""
peer_names="ikd_tree i_octree nanoflann small_gicp kiss_matcher robin xenium pmc teaser gtsam"
peer_paths=() sources=() packages_by_path=""
for name in $peer_names; do peer_paths+=("-DCHAINSLAM_PEER_${name^^}="); done
while [ $# -gt 0 ]; do
  case "$1" in
    --json) [ $# -ge 2 ] || { usage >&2; exit 2; }; json="$2"; shift ;;
    --table) [ $# -ge 2 ] || { usage >&2; exit 2; }; table="$2"; shift ;;
    --peers) peers=ON ;;
    --peer)
      [ $# -ge 2 ] || { usage >&2; exit 2; }
      [[ "$2" =~ ^(${peer_names// /|})=(.+)$ ]] || { usage >&2; echo "bench/run.sh: --peer $2: unknown peer, or no path" >&2; exit 2; }
      [ -d "${BASH_REMATCH[2]}" ] || { echo "bench/run.sh: --peer $2: no such folder" >&2; exit 2; }
      sources+=("${BASH_REMATCH[1]}=$(cd "${BASH_REMATCH[2]}" && pwd)")
      peer_paths+=("-DCHAINSLAM_PEER_${BASH_REMATCH[1]^^}=${sources[-1]#*=}")
      [ "${BASH_REMATCH[1]}" != kiss_matcher ] || packages_by_path="$packages_kiss_matcher"
      shift ;;
    --no-plain) plain=no ;;
    --seconds)
      [[ "${2:-}" =~ ^[0-9]*\.?[0-9]+$ ]] || { usage >&2; echo "bench/run.sh: --seconds takes a number" >&2; exit 2; }
      minimum_time="$2"; shift ;;
    --smoke) minimum_time=0.001 plain=no; export CHAINSLAM_BENCH_BRIEF=1 ;;
    -h | --help) usage; exit 0 ;;
    -*) usage >&2; echo "bench/run.sh: unknown option $1" >&2; exit 2 ;;
    *) filter="$1" ;;
  esac
  shift
done
given=" ${sources[*]%%=*} "
for needed in kiss_matcher=robin kiss_matcher=xenium kiss_matcher=pmc teaser=pmc; do
  [[ "$given" != *" ${needed%=*} "* || "$given" == *" ${needed#*=} "* ]] ||
    { echo "bench/run.sh: --peer ${needed%=*} needs --peer ${needed#*=}=PATH, too" >&2; exit 2; }
done
case "$json" in "" | /*) ;; *) json="$PWD/$json" ;; esac
case "$table" in "" | /*) ;; *) table="$PWD/$table" ;; esac
[ -z "$table" ] || packages_bench="$packages_bench python3"

# shellcheck disable=SC2086
if [ "$peers" = ON ]; then
  install_packages $packages_build $packages_program $packages_bench $packages_by_path $packages_peers
else
  install_packages $packages_build $packages_program $packages_bench $packages_by_path
fi
unpack_data
[ "$peers" = ON ] || say "skipped" "peers PCL, Open3D and Ceres (bench/run.sh --peers installs and builds them)"

modules=()
for file in "$root"/bench/*/*_bench.cpp; do modules+=("$(basename "$(dirname "$file")")"); done
mapfile -t modules < <(printf '%s\n' "${modules[@]}" | sort -u)
# Names begin with their module: a filter that says which needs no other module built.
if [[ "$filter" =~ ^\^?([a-z_]+)/[^|]*$ ]] && [ -d "$root/bench/${BASH_REMATCH[1]}" ]; then modules=("${BASH_REMATCH[1]}"); fi
targets="${modules[*]/#/bench_}"
columns=("")
if [ "$plain" = yes ]; then
  columns+=(_plain)
  for module in "${modules[@]}"; do targets="$targets bench_${module}_plain"; done
fi
configure_and_build bench "the benches, -O3" "$targets" -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_COMPILER=g++ \
  -DCHAINSLAM_BUILD_TESTS=OFF -DCHAINSLAM_BENCH_PEERS=$peers "${peer_paths[@]}"

results="$build/bench/results"
rm -rf "$results" && mkdir -p "$results"
ran=0
for column in "${columns[@]}"; do
  say "column" "$([ -z "$column" ] && echo '-O3 -march=native' || echo '-O3, plain x86-64')"
  for module in "${modules[@]}"; do
    "$build/bench/bench/bench_$module$column" --benchmark_filter="${filter:-.}" --benchmark_min_time="$minimum_time" \
      --benchmark_counters_tabular=true --benchmark_out="$results/$module$column.json" --benchmark_out_format=json \
      2>"$results/$module$column.log" || { cat "$results/$module$column.log" >&2; fail "bench_$module$column stopped"; }
    if grep -q '"error_occurred": true' "$results/$module$column.json" 2>/dev/null; then
      fail "bench_$module$column reports an error (see above)"
    fi
    count="$(grep -c '"run_type"' "$results/$module$column.json" 2>/dev/null || true)"
    ran=$((ran + ${count:-0}))
  done
done
[ "$ran" -gt 0 ] || fail "no bench matches '$filter'" 2

# One JSON file: the context of the first run, and the results of all; plain ones carry "plain/" before their names.
# A program without a bench of the filter's leaves its file empty.
if [ -n "$json" ]; then
  {
    first=yes
    for file in "$results"/*.json; do
      body="$(sed '1,/"benchmarks": \[/d' "$file" | sed '$d' | sed '$d')"
      [ -n "${body//[[:space:]]/}" ] || continue
      [ "$first" = no ] || sed '/"benchmarks": \[/q' "$file"
      case "$file" in *_plain.json) body="$(sed 's|"name": "|"name": "plain/|; s|"run_name": "|"run_name": "plain/|' <<<"$body")" ;; esac
      [ "$first" = yes ] || echo "    ,"
      first=no
      printf '%s\n' "$body"
    done
    printf '  ]\n}\n'
  } >"$json.part" && mv "$json.part" "$json" || fail "cannot write $json"
  say "json" "$json"
fi
# The compiler and the peers with their versions: of a package, of a GTSAM that is installed, or the commit of a checkout.
programs() {
  local text name path version
  text="g++ $(g++ -dumpfullversion)"
  for name in Eigen=libeigen3-dev nanoflann=libnanoflann-dev SuiteSparse=libsuitesparse-dev Boost=libboost-dev \
    PCL=libpcl-dev Open3D=libopen3d-dev Ceres=libceres-dev; do
    case "$name" in PCL=* | Open3D=* | Ceres=*) [ "$peers" = ON ] || continue ;; esac
    version="$(dpkg-query -W -f='${source:Upstream-Version}' "${name#*=}" 2>/dev/null | sed 's/^[0-9]*://; s/+.*//')" || true
    text="$text, ${name%%=*}${version:+ $version}"
  done
  for name in ${sources[@]+"${sources[@]}"}; do
    path="${name#*=}"
    version="$(sed -n 's/^set(PACKAGE_VERSION "\(.*\)")/\1/p' "$path"/lib*/cmake/GTSAM/GTSAMConfigVersion.cmake 2>/dev/null)" || true
    if [ -e "$path/.git" ]; then version="$(git -C "$path" rev-parse --short HEAD 2>/dev/null)" || true; fi
    text="$text, ${name%%=*}${version:+ $version}"
  done
  for path in /usr/lib/*/libblas.so.3; do  # CHOLMOD and Ceres depend on it
    [ ! -e "$path" ] || text="$text, BLAS $(basename "$(dirname "$(readlink -f "$path")")")"
  done
  echo "$text"
}
if [ -n "$table" ]; then
  PYTHONPATH="$root/bench" PYTHONDONTWRITEBYTECODE=1 "$(debian_python)" -m benchmark_tables "$table" "$command" "$(programs)" \
    "$results"/*.json ||
    fail "cannot write $table"
  say "table" "$table"
fi
say "passed" "$ran benches ran"
