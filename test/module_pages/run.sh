#!/usr/bin/env bash
# Compiles the programs of the modules' pages (include/chainslam/*/README.md): each block marked cpp by itself, as it stands.
# usage: test/module_pages/run.sh INCLUDE-FOLDER...; asks $CXX, else clang++-14
set -euo pipefail
[ $# -gt 0 ] || { sed -n 2,3p "$0" >&2; exit 2; }
compiler="${CXX:-clang++-14}"
flags=(-std=c++20 -Wall -Wextra -Werror)
for folder in "$@"; do flags+=(-isystem "$folder"); done
for flag in $(pkg-config --cflags-only-I eigen3); do flags+=(-isystem "${flag#-I}"); done

scratch="$(mktemp -d)"
trap 'rm -r "$scratch"' EXIT
failed=0 blocks=0
for page in "$1"/chainslam/*/README.md; do
  module="$(basename "$(dirname "$page")")"
  [ "$(wc -l <"$page")" -le 60 ] || { echo "FAILED: $module: the page is longer than 60 lines"; failed=$((failed + 1)); }
  awk -v prefix="$scratch/$module" '/^```cpp/ { inside = 1; ++n; next } /^```/ { inside = 0 }
    inside { print > (prefix "_" n ".cpp") }' "$page"
  [ -e "$scratch/${module}_1.cpp" ] || { echo "FAILED: $module: the page has no program"; failed=$((failed + 1)); continue; }
  grep -q '^int main' "$scratch/$module"_*.cpp || { echo "FAILED: $module: no program has a main"; failed=$((failed + 1)); }
  for block in "$scratch/$module"_*.cpp; do
    blocks=$((blocks + 1))
    "$compiler" "${flags[@]}" -fsyntax-only "$block" 2>"$scratch/errors" ||
      { echo "FAILED: $page: block $(basename "$block" .cpp)"; head -n 20 "$scratch/errors"; failed=$((failed + 1)); }
  done
done
for folder in "$1"/chainslam/*/; do
  case "$folder" in */compiled/) continue ;; esac
  [ -e "$folder/README.md" ] || { echo "FAILED: $folder has no page"; failed=$((failed + 1)); }
done
echo "module pages: $blocks programs, $failed failed"
[ "$failed" -eq 0 ] && [ "$blocks" -gt 17 ]
