#!/usr/bin/env bash
# Checks that every header compiles alone, included by nothing but itself.
# usage: test/headers.sh [--all] INCLUDE-FOLDER
#   --all  also those in folders `detail`, which users do not include
# Asks $CXX, else clang++-14. Headers that several others include are precompiled, and each of the others is read on top of
# the largest of those that it includes, itself or through others: what is common to many is read a few times, not hundreds.
# What a function would instantiate is left to those who include it.
set -euo pipefail
all=no
if [ "${1-}" = --all ]; then all=yes; shift; fi
[ $# -eq 1 ] || { sed -n 3,4p "$0" >&2; exit 2; }
include="$(cd "$1" && pwd)"
compiler="${CXX:-clang++-14}"
command -v "$compiler" >/dev/null || { echo "headers: no compiler $compiler" >&2; exit 2; }

flags=(-std=c++20 -I "$include")
for flag in $(pkg-config --cflags-only-I eigen3); do flags+=(-isystem "${flag#-I}"); done
for folder in {/usr/local,/usr}/include/suitesparse; do [ -d "$folder" ] && flags+=(-isystem "$folder"); done

scratch="$(mktemp -d)"
trap 'rm -r "$scratch"' EXIT

# The check itself must be able to fail: a header that does not include what it needs, though what it includes is there.
mkdir "$scratch/chainslam"
printf '#include "chainslam/core/version.hpp"\ninline std::vector<int> without_include;\n' >"$scratch/chainslam/bad.hpp"
flags+=(-I "$scratch")

# write_build_file: reads `HEADER:` for each header and `HEADER:#include LINE`; writes Ninja's build file, whose targets
# are the headers.
write_build_file() {
  LC_ALL=C awk -v compiler="$compiler" -v flags="${flags[*]}" '
    function closure(header, reached,   list, i, size) {  # the headers that come with it, and how many they are
      if (header in reached) return 0
      reached[header] = 1
      split(includes[header], list, " ")
      for (i in list) size += closure(list[i], reached)
      return size + 1
    }
    function largest(header, bases,   reached, other, best) {  # of what it includes
      closure(header, reached)
      delete reached[header]
      for (other in reached)
        if (other in bases && (size[other] > size[best] || (size[other] == size[best] && other < best))) best = other
      return best
    }
    function build(header, output, options, base) {
      print "build " output ": compile" (base ? " | " base ".pch" : "")
      print "  header = " header "\n  options = " (base ? "-include-pch " base ".pch " : "") options
    }
    {
      header = substr($0, 1, index($0, ":") - 1)
      ours[header] = 1
      if (split($0, part, /[<">]/) > 2) {
        if (part[2] ~ /^Eigen\// && part[2] != "Eigen/Geometry") part[2] = "Eigen/Core"
        includes[header] = includes[header] " " part[2]
      }
    }
    END {
      eigen["Eigen/Core"] = eigen["Eigen/Geometry"] = 1
      includes["Eigen/Geometry"] = "Eigen/Core"
      for (header in ours) { delete reached; size[header] = closure(header, reached) }
      size["Eigen/Core"] = 1; size["Eigen/Geometry"] = 2
      for (header in ours) ++followers[largest(header, ours)]
      for (header in ours) if (followers[header] > 1 && size[header] > 4) common[header] = 1
      print "rule compile\n  command = echo \"#include <$header>\" | " compiler " " flags " -x c++-header - $options"
      for (header in eigen) build(header, header ".pch", "-o " header ".pch", "")
      for (header in common) build(header, header ".pch", "-o " header ".pch", largest(header, eigen))
      for (header in eigen) common[header] = 1
      for (header in ours)
        if (header in common) print "build " header ": phony " header ".pch"
        else build(header, header, "-fsyntax-only", largest(header, common))
    }'
}

cd "$include"
{
  find chainslam -name '*.hpp' | sed 's/$/:/'
  find chainslam -name '*.hpp' -exec grep -H '^#include ["<]\(chainslam\|Eigen\)/' {} +
  echo 'chainslam/bad.hpp:#include "chainslam/core/version.hpp"'
} | write_build_file >"$scratch/build.ninja"
wanted=(-name '*.hpp' -not -path chainslam/chainslam.hpp)  # that one is for consumers to compile
[ "$all" = yes ] || wanted+=(-not -path '*/detail/*')
mapfile -t headers < <(find chainslam "${wanted[@]}")
cd "$scratch"
if ninja chainslam/bad.hpp >bad.log; then
  echo "headers: the check does not see a missing include" >&2
  exit 1
fi
status=0
ninja -k 0 -j "${CHAINSLAM_JOBS:-$(nproc)}" "${headers[@]}" >log || status=$?
sed '/^\[[0-9]*\/[0-9]*\] echo/d' log | head -n 200
echo "headers: ${#headers[@]}, $(grep -c '^build chain.*pch: compile' build.ninja) of them precompiled for others"
exit "$status"
