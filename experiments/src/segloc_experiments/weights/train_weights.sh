#!/usr/bin/env bash
# Weights from nothing: simulated worlds, a dataset of their segments, the networks and forests.
#   experiments/src/segloc_experiments/weights/train_weights.sh OUT
# On two cores half an hour for the dataset, and an hour and a half for all networks (`esm` and
# `segmap` need most of it). What is done stays: started again, it goes on where it was.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1" && cd "$1"
export OPENBLAS_NUM_THREADS=1
segloc train extract --simulate town:5,park:2,meadow:2,forest:2,industrial:2 --drive 300 --thin 2 \
  --seed 5 --out worlds
train() {
  for network; do
    segloc train "$network" worlds --config "$here/train_$network.yaml" --threads 1 \
      --out "$network.safetensors"
  done
}
train segmap profile &
train esm dsm &
wait
for method in segmatch-eigen segmatch-esf nsm; do
  segloc train forest "$method" worlds --out "$method-forest.safetensors"
done
# How good they are in worlds that training did not see.
segloc train extract --simulate town:1,park:1,meadow:1,forest:1,industrial:1 --drive 300 --thin 2 \
  --seed 77 --out others
for name in geo {profile,dsm,esm,segmap}.safetensors; do segloc train score "$name" others; done
