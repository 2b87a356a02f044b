# Sourced by the scripts: finds the folder of real data and unpacks its archives once.
#
# In:   CHAINSLAM_DATA  a folder of data sets; if unset, ../shared/data beside the checkout is taken when it is there.
#       build           the build folder; everything is unpacked below it, the data itself is never written to.
# Out:  CHAINSLAM_UNPACKED_DATA, exported: the unpacked folder, or empty when there is no data.
# An archive a/b.tar.xz is unpacked into a/b/, a/c.zip into a/c/, a file a/d.txt.xz to a/d.txt; other files are linked.

unpack_data() {
  local source="${CHAINSLAM_DATA:-}" file target
  export CHAINSLAM_UNPACKED_DATA=""
  if [ -z "$source" ] && [ -d "$root/../shared/data" ]; then source="$root/../shared/data"; fi
  if [ -z "$source" ]; then
    echo "data         none: CHAINSLAM_DATA is unset and ../shared/data is not there"
    return 0
  fi
  if [ ! -d "$source" ]; then
    echo "data         CHAINSLAM_DATA=$source is not a folder; set it to a folder of data sets, or unset it" >&2
    return 1
  fi
  source="$(cd "$source" && pwd)"
  while IFS= read -r -d '' file; do
    target="$build/data/${file#"$source"/}"
    case "$file" in
      *.tar.xz) target="${target%.tar.xz}" ;;
      *.tar) target="${target%.tar}" ;;
      *.zip) target="${target%.zip}" ;;
      *.xz) target="${target%.xz}" ;;
    esac
    if [ -e "$target" ] && [ ! "$file" -nt "$target.stamp" ]; then continue; fi
    mkdir -p "$(dirname "$target")"
    rm -rf "$target" "$target.part"
    case "$file" in
      *.tar.xz | *.tar) mkdir "$target.part" && tar -xf "$file" -C "$target.part" --no-same-owner ;;
      *.zip) mkdir "$target.part" && unzip -q "$file" -d "$target.part" ;;
      *.xz) xz -dc "$file" >"$target.part" ;;
      *) ln -s "$file" "$target.part" ;;
    esac || { echo "data         cannot unpack $file into $target.part (disk full? archive damaged?)" >&2; return 1; }
    mv "$target.part" "$target" && touch "$target.stamp"
  done < <(find "$source" -type f -print0)
  CHAINSLAM_UNPACKED_DATA="$build/data"
  echo "data         $source, unpacked into $CHAINSLAM_UNPACKED_DATA"
}
