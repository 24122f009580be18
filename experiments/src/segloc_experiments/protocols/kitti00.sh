#!/usr/bin/env bash
# The protocols on real scans: KITTI odometry 00 as keyframes and full scans with TUM poses.
#   experiments/src/segloc_experiments/protocols/kitti00.sh DATA OUT METHOD...
set -euo pipefail
data=$1 out=$2
shift 2
mkdir -p "$out"
for method in "$@"; do
  # Accumulated: the first half of the drive is the map, queries are all of the rest, every 10 m.
  segloc map build "$data/keyframes" --poses keyframes.tum --select 100:947 --method "$method" \
    --out "$out/first-$method.segmap" --threads 1
  segloc localize "$data/keyframes" --map "$out/first-$method.segmap" --poses keyframes.tum \
    --select 948:1820 --every 10 --truth keyframes.tum --threads 1 --out "$out/accumulated-$method"
  # Sparse: the same places, one thinned keyframe each.
  segloc localize "$data/keyframes" --map "$out/first-$method.segmap" --select 948:1820 --every 10 \
    --truth keyframes.tum --threads 1 --out "$out/sparse-$method"
  # One-shot: a map of the later passes, and every full scan of the first 827 m by itself.
  segloc map build "$data/keyframes" --poses keyframes.tum --select 619:654,988:1003,1361:1600 \
    --method "$method" --out "$out/later-$method.segmap" --threads 1
  segloc localize "$data/scans" --map "$out/later-$method.segmap" --truth scans.tum --threads 1 \
    --out "$out/single-$method"
done
