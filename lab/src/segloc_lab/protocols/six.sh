#!/usr/bin/env bash
# The six simulated places: each map, and every session that is localized in it.
#   segloc simulate --suite six --out SETS
#   lab/src/segloc_lab/protocols/six.sh SETS OUT METHOD...
set -euo pipefail
sets=$1 out=$2
shift 2
mkdir -p "$out"
for method in "$@"; do
  for set in "$sets"/*/; do
    name=$(basename "$set")
    segloc map build "$set/map" --poses poses.tum --method "$method" --threads 1 \
      --out "$out/$name-$method.segmap"
    every=(--every 10)
    # A swathe of a push-broom sensor is a query by itself: they lie 30 m apart.
    if grep -q '"sensor": "lms151"' "$set/scene.json"; then every=(); fi
    for test in "$set"/test_*/; do
      segloc localize "$test" --map "$out/$name-$method.segmap" --poses odometry.tum \
        --truth poses.tum "${every[@]}" --threads 1 --out "$out/$name-$(basename "$test")-$method"
    done
  done
done
