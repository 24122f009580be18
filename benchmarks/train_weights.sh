#!/usr/bin/env bash
# Weights from nothing: simulated worlds, a dataset of their segments, the networks. The shipped
# weights of `profile` were made so.
#   benchmarks/train_weights.sh OUT
# On two cores about half an hour for the dataset, and half an hour a network, side by side. What is
# done stays: started again, it goes on where it was.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1" && cd "$1"
export OPENBLAS_NUM_THREADS=1
segloc train extract --simulate town:5,park:2,meadow:2,forest:2,industrial:2 --drive 300 --thin 2 \
  --seed 5 --out worlds
for network in profile dsm; do
  segloc train "$network" worlds --config "$here/train_$network.yaml" --threads 1 \
    --out "$network.safetensors" &
done
wait
# How good they are in worlds that training did not see.
segloc train extract --simulate town:1,park:1,meadow:1,forest:1,industrial:1 --drive 300 --thin 2 \
  --seed 77 --out others
for name in geo profile.safetensors dsm.safetensors; do segloc train score "$name" others; done
