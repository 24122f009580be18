#!/usr/bin/env bash
# Training and test datasets of KITTI odometry 00, by place: no place is in both.
#   lab/src/segloc_lab/weights/kitti00_datasets.sh DATA OUT
# DATA holds keyframes/, scans/ and their TUM poses. The passes over a place are aligned with each
# other, since the ground truth is good to about a metre across passes. KITTI is CC BY-NC-SA 3.0:
# neither these datasets nor weights trained on them are shipped.
set -euo pipefail
data=$1 out=$2

# extract SPLIT PLACE RANGE...: the first range is the first pass, which later ones are aligned with.
extract() {
  local split=$1 place=$2 sequences=() ranges=()
  shift 2
  for range in "$@"; do
    sequences+=("$data/keyframes")
    ranges+=(--select "$range")
  done
  segloc train extract "${sequences[@]}" --poses "$data/keyframes.tum" "${ranges[@]}" \
    --place "$place" --sensor hdl64e --length 40 --length 16 --out "$out/$split"
}

extract train loop 169:373 1414:1600
for range in 655:947 1004:1360 1601:1820; do
  extract train "street-${range%:*}" "$range"
done
extract test square 948:999 1361:1413
extract test start 48:81 619:654
extract test corner 158:170 988:1003

# Full scans against keyframes of a later pass.
single() {
  segloc train extract "$data/keyframes" "$data/scans" --poses "$data/keyframes.tum" \
    --poses "$data/scans.tum" --select "$2" --select "$3" --place "$1" --sensor hdl64e \
    --length 40 --length 16 --length 0 --every 4 --out "$out/single"
}
single start 619:654 56:76
single corner 988:1003 152:166
