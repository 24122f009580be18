# make demo: simulate, map, localize, report.   make test: every test.   make quick: in a minute.
# make evaluate [SCALE=full]: the experiments of the paper.   Each sets itself up.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SCALE ?= small
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test quick test-lowest fuzz evaluate lint sanitize wheel-check clean

demo: $(VENV)/.demo
	$(BIN)/segloc demo --out demo

evaluate: $(VENV)/.evaluate
	$(BIN)/segloc evaluate all --suite six --scale $(SCALE) --out evaluation

# One process a core, one thread each. Files stay whole: their fixtures are made once.
CORES ?= logical
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(CORES) --dist loadfile

test: $(VENV)/.test
	$(PYTEST)

quick: $(VENV)/.test
	$(PYTEST) -m "not slow and not data and not torch"

# The quick tests with Python 3.10 and exactly the lowest versions that pyproject.toml allows.
LOWEST := build/lowest
LOWEST_PYTHON ?= $(firstword $(wildcard /root/.pyenv/versions/3.10.*/bin/python) $(shell command -v python3.10))
LOWEST_EXTRAS := io,sim,report,baselines,odometry,ros,packets

test-lowest:
ifeq ($(LOWEST_PYTHON),)
	@echo "test-lowest: skipped: no Python 3.10 (name one by LOWEST_PYTHON=...)"
else
	$(LOWEST_PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python .ci/lowest.py $(LOWEST_EXTRAS) test-tools > $(LOWEST)/lowest.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check \
	  -c $(LOWEST)/lowest.txt ".[$(LOWEST_EXTRAS),test-tools]"
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(LOWEST)/bin/python -m pytest -n $(CORES) \
	  --dist loadfile -W default::DeprecationWarning -m "not slow and not data and not torch" tests
endif

# Coverage-guided fuzzing of the readers, a minute a target. What is found joins tests/hostile/found.
SECONDS ?= 60

fuzz: $(VENV)/.fuzz
	$(BIN)/python tests/fuzz/run.py $(SECONDS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The kernels' own tests, under AddressSanitizer and UndefinedBehaviorSanitizer.
sanitize: $(VENV)/.dev
	$(BIN)/cmake -S cpp/tests -B build/sanitize -DCMAKE_BUILD_TYPE=RelWithDebInfo -DSEGLOC_SANITIZE=ON
	$(BIN)/cmake --build build/sanitize --parallel 2
	build/sanitize/kernel_tests

# The wheel must install and localize where there is nothing else: no torch, no compiler, no plotting,
# no laboratory. The wheel of the experiments adds its verbs.
wheel-check: $(BIN)/python
	rm -rf build/wheel && mkdir -p build/wheel
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/wheel/venv
	build/wheel/venv/bin/python -m pip install --quiet --disable-pip-version-check build/wheel/*.whl
	cd build/wheel && venv/bin/segloc --version
	cd build/wheel && venv/bin/python ../../tests/wheel_smoke.py
	! $(BIN)/python -m zipfile -l build/wheel/segloc-*.whl | grep -E "experiments|kitti00|benchmarks"
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel ./experiments
	build/wheel/venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps build/wheel/segloc_experiments-*.whl
	cd build/wheel && venv/bin/segloc bench --help > /dev/null && venv/bin/segloc evaluate roc --help > /dev/null
	ls -l build/wheel/*.whl

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# One stamp for each set of extras; an editable install, so only native sources call for a new one.
NATIVE := $(shell find cpp -name '*.cpp' -o -name '*.h') CMakeLists.txt pyproject.toml constraints.txt
$(VENV)/.%: $(NATIVE) | $(BIN)/python
	$(PIP) -e ".[$*]"
	@touch $@

# The experiments are a distribution of their own, which adds verbs to segloc.
LABORATORY := $(NATIVE) experiments/pyproject.toml
$(VENV)/.evaluate: $(LABORATORY) | $(BIN)/python
	$(PIP) -e ".[io]" -e ./experiments
	@touch $@

$(VENV)/.test $(VENV)/.dev: $(VENV)/.%: $(LABORATORY) | $(BIN)/python
	$(PIP) -e ".[$*]" -e ./experiments
	@touch $@

clean:
	rm -rf build $(VENV)
