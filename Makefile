# `make help` lists the targets. Each sets itself up, in the environment VENV.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
SCALE ?= small
# Native builds are kept by environment, so that two of them do not disturb each other, all as deep
# below their sources, so that a compiler's cache finds the same paths. Nothing is compiled to
# bytecode but what is imported.
INSTALL := -m pip install --quiet --disable-pip-version-check --no-compile
PIP := SKBUILD_BUILD_DIR=build/native/$(notdir $(VENV)) $(BIN)/python $(INSTALL) -c constraints.txt
# The extras that tests find. CI has them from those of `dev`, which are these and more.
TESTED ?= test

.DEFAULT_GOAL := help
.PHONY: help demo test quick golden test-lowest test-newest test-ros fuzz evaluate lint docs wheel-check
.PHONY: clean cross-check sanitize sanitize-python sanitize-threads fuzz-native

help: ## List the targets.
	@sed -nE 's/^([a-z-]+):.*## (.*)/\1|\2/p' $(MAKEFILE_LIST) | awk -F'|' '{printf "  make %-18s %s\n", $$1, $$2}'

# What `pip install` has put into the environment is used as it is, and not compiled again.
demo: $(if $(wildcard $(BIN)/segloc),,$(VENV)/.report) ## Map the sample drive, localize another day and another place, report (1 min).
	$(BIN)/segloc demo --out demo

evaluate: $(VENV)/.evaluate ## Run the paper's studies: SCALE=small, full or paper (hours).
	$(BIN)/segloc evaluate all --suite six --scale $(SCALE) --out evaluation

# One process a core, one thread each. Files stay whole: their fixtures are made once.
CORES ?= logical
ALONE := env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
PYTEST := $(ALONE) $(BIN)/python -m pytest -n $(CORES) --dist loadfile --no-loadscope-reorder

test: $(VENV)/.$(TESTED) ## Run every test.
	$(PYTEST)

QUICK := -m "not slow and not data and not torch and not fuzz"
quick: $(VENV)/.$(TESTED) ## Run the quick tests: what a change of code usually needs.
	$(PYTEST) $(QUICK)

# Answers of a fixed corpus beside the stored ones, bit for bit: ACCEPT=1 stores them anew, and
# GROUPS="world-town kernels" takes some. THREADS changes nothing but the time.
THREADS ?= 1
golden: $(VENV)/.$(TESTED) ## Compare the answers of a fixed corpus, bit for bit; ACCEPT=1 records them anew.
	$(ALONE) GOLDEN_THREADS=$(THREADS) PYTHONPATH=tests $(BIN)/python -m golden $(GROUPS) $(if $(ACCEPT),--accept)

# The quick tests of an installed wheel: with Python 3.10 and exactly the lowest versions that
# pyproject.toml allows, and with Python 3.13 and the newest of everything.
EXTRAS := io,report,odometry,ros,packets,tiles
LOWEST_PYTHON ?= $(firstword $(wildcard /root/.pyenv/versions/3.10.*/bin/python) $(shell command -v python3.10))
NEWEST_PYTHON ?= $(firstword $(wildcard /root/.pyenv/versions/3.13.*/bin/python) $(shell command -v python3.13))

# Of a Python, a name for its folder, and options for pip and for pytest.
define test_installed
	$(if $(1),,$(error no such Python: name one by $(shell echo $(2) | tr a-z A-Z)_PYTHON=...))
	$(1) -m venv build/$(2)
	SKBUILD_BUILD_DIR=build/native/$(2) build/$(2)/bin/python $(INSTALL) --upgrade $(3) \
	  ".[$(EXTRAS),test-tools]" embreex scikit-learn
	build/$(2)/bin/python $(INSTALL) --no-deps ./lab ./plugins/segloc-stems
	$(ALONE) build/$(2)/bin/python -m pytest -n $(CORES) --dist loadfile $(4) $(QUICK) $(if $(filter smoke,$(TESTS)),$(SMOKE),$(TESTS))
endef

# What test-lowest and test-newest run: all, or paths, or TESTS=smoke, for which a minute is enough.
TESTS ?= tests
SMOKE := tests/test_localizer.py tests/proposals/test_pose.py tests/proposals/test_matching.py tests/frontend/test_segmentation.py \
  tests/map/test_file.py tests/tools/io tests/tools/cli/test_help.py tests/descriptors tests/tools/datasets/ros

build/lowest/.ready: pyproject.toml .ci/lowest.py
	mkdir -p build
	$(LOWEST_PYTHON) .ci/lowest.py $(EXTRAS) test-tools > build/lowest.txt
	$(LOWEST_PYTHON) -m venv build/lowest
	build/lowest/bin/python $(INSTALL) -r build/lowest.txt
	@touch $@

test-lowest: build/lowest/.ready ## Run the quick tests with Python 3.10 and the lowest versions of all dependencies.
	$(call test_installed,$(LOWEST_PYTHON),lowest,-c build/lowest.txt,-W default::DeprecationWarning)

test-newest: ## Run the quick tests with Python 3.13 and the newest versions.
	$(call test_installed,$(NEWEST_PYTHON),newest,--upgrade-strategy eager)

# The ROS 2 packages, built by colcon and run as nodes, with ROS 2 from PyPI's wheels: Linux, and
# Python 3.11 in .venv.
test-ros: $(VENV)/.$(TESTED) ## Run the ROS 2 packages as nodes (Linux, Python 3.11).
	tests/ros2/run.sh $(BIN)/python

# Coverage-guided fuzzing of the readers, a minute a target. What is found joins tests/hostile/found.
SECONDS ?= 60

fuzz: $(VENV)/.fuzz ## Fuzz the readers, SECONDS=60 a target.
	$(BIN)/python tests/fuzz/run.py $(SECONDS)

# The documentation site, into build/site/html; a broken link is an error.
docs: $(VENV)/.dev ## Build the documentation site.
	$(BIN)/python docs/site.py
	$(BIN)/zensical build --strict --clean

# Documents that are checked for spelling and style; the changelog and the reports are history.
PROSE := README.md CONTRIBUTING.md SECURITY.md docs
lint: $(VENV)/.dev ## Run ruff, mypy, codespell and the style of the documents.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell $(PROSE)
	$(BIN)/python docs/style.py $(PROSE)

# Builds that watch themselves. The kernels' own tests, under AddressSanitizer and UBSan:
CHECKED := -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1"
VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
SANITIZED := build/sanitize
sanitize: $(VENV)/.dev ## Run the kernels' tests under AddressSanitizer and UBSan.
	$(BIN)/cmake -S . -B $(SANITIZED) $(CHECKED) -DSEGLOC_SANITIZE=address -DSEGLOC_TESTS=ON \
	  -DPython_EXECUTABLE=$(abspath $(BIN))/python -DSKBUILD_PROJECT_VERSION=$(VERSION)
	$(BIN)/cmake --build $(SANITIZED) --parallel 2 --target kernel_tests
	$(SANITIZED)/cpp/tests/kernel_tests

# The Python module likewise, in tests of what it is given: shapes, values and types of all kinds.
# Python itself is not built so: the sanitizer is loaded before it, and its own leaks are not ours.
# pytest-xdist may wait for ever for a worker that the sanitizer has ended: hence the time limit.
sanitize-python: sanitize $(VENV)/.$(TESTED) ## Run the native module under them.
	$(BIN)/cmake --build $(SANITIZED) --parallel 2 --target _native
	timeout 30m env SEGLOC_NATIVE="$$(ls $(abspath $(SANITIZED))/_native*.so)" PYTHONPATH=$(abspath tests/sanitized):src \
	  ASAN_OPTIONS=detect_leaks=0:allocator_may_return_null=1 PYTHONMALLOC=malloc \
	  LD_PRELOAD="$$($(CXX) -print-file-name=libasan.so) $$($(CXX) -print-file-name=libstdc++.so.6)" \
	  $(PYTEST) -m "not slow and not data and not torch" -k "not localizes and not test_own" \
	  tests/test_bindings.py tests/proposals/test_pose.py tests/proposals/test_matching.py tests/frontend/test_segmentation.py \
	  tests/likelihood/test_registration.py tests/likelihood tests/descriptors

# The kernels' tests, several callers at once among them, under ThreadSanitizer: on demand. It wants
# its memory where it looks for it.
sanitize-threads: $(VENV)/.dev ## Run the kernels' tests under ThreadSanitizer.
	$(BIN)/cmake -S cpp/tests -B build/sanitize-threads $(CHECKED) -DSEGLOC_SANITIZE=thread
	$(BIN)/cmake --build build/sanitize-threads --parallel 2
	TSAN_OPTIONS=halt_on_error=1 setarch $$(uname -m) -R build/sanitize-threads/kernel_tests

# Random inputs for SECONDS each, by Clang's libFuzzer. What breaks one is left in build/fuzz.
FUZZERS := $(patsubst cpp/fuzz/%_fuzzer.cpp,%,$(wildcard cpp/fuzz/*_fuzzer.cpp))
fuzz-native: $(VENV)/.dev ## Fuzz the kernels by libFuzzer, SECONDS=60 each.
	CXX=clang++ $(BIN)/cmake -S cpp/fuzz -B build/fuzz $(CHECKED)
	$(BIN)/cmake --build build/fuzz --parallel 2
	set -e; for name in $(FUZZERS); do mkdir -p build/fuzz/corpus/$$name; \
	  build/fuzz/$${name}_fuzzer -max_total_time=$(SECONDS) -timeout=20 -rss_limit_mb=2048 \
	  -verbosity=0 -artifact_prefix=build/fuzz/$$name- build/fuzz/corpus/$$name cpp/fuzz/seeds/$$name; done

# The wheels. segloc's is built from its source distribution alone, must be small, and must install
# and localize where there is nothing else: no torch, no compiler, no plotting, no laboratory. Built
# by Python 3.12 it is for all later ones: it is audited, and tried on the newest too. The wheel of
# the laboratory adds weights and verbs. A copy is packed, as the tool looks at every file around.
WHEEL := build/wheel
WHEEL_TOOLS := build/wheel-tools
WHEEL_PYTHON ?= $(firstword $(wildcard /root/.pyenv/versions/3.12.*/bin/python) $(shell command -v python3.12) $(PYTHON))
MOST_BYTES := 15000000
wheel-check: $(WHEEL_TOOLS)/.ready ## Build, audit and try the wheels.
	rm -rf $(WHEEL) && mkdir -p $(WHEEL)
	mkdir $(WHEEL)/source && tar -c $(patsubst %,--exclude=./%,build .venv .git) . | tar -x -C $(WHEEL)/source
	SKBUILD_BUILD_DIR=build/native/wheel $(WHEEL_TOOLS)/bin/python -m build --outdir $(WHEEL) $(WHEEL)/source > $(WHEEL)/log || { tail -40 $(WHEEL)/log; exit 1; }
	$(WHEEL_TOOLS)/bin/python -m build --no-isolation --outdir $(WHEEL) lab >> $(WHEEL)/log
	$(WHEEL_TOOLS)/bin/python -m build --no-isolation --outdir $(WHEEL) plugins/segloc-stems >> $(WHEEL)/log
	$(WHEEL_TOOLS)/bin/auditwheel show $(WHEEL)/segloc-*.whl
	case $$(echo $(WHEEL)/segloc-*.whl) in *abi3*) $(WHEEL_TOOLS)/bin/abi3audit --strict $(WHEEL)/segloc-*.whl ;; esac
	! $(WHEEL_TOOLS)/bin/python -m zipfile -l $(WHEEL)/segloc-*.whl | grep -E "_lab|kitti00|benchmarks|(segmap|forest).safetensors"
	test $$(stat -c %s $(WHEEL)/segloc-*.whl) -lt $(MOST_BYTES)
	$(call try_wheel,$(WHEEL_PYTHON),$(WHEEL)/venv,,segmap segmatch-esf nsm)
	case $$(echo $(WHEEL)/segloc-*.whl) in *abi3*) $(call try_wheel,$(or $(NEWEST_PYTHON),$(WHEEL_PYTHON)),$(WHEEL)/newest,profile,segmap) ;; esac
	ls -l $(WHEEL)/*.whl $(WHEEL)/*.tar.gz

$(WHEEL_TOOLS)/.ready:
	$(WHEEL_PYTHON) -m venv $(WHEEL_TOOLS)
	$(WHEEL_TOOLS)/bin/python $(INSTALL) build auditwheel abi3audit "hatchling>=1.24"
	@touch $@

# Of a Python, a folder, and the methods that are tried: the wheels in an environment of their own,
# first that of segloc alone (no methods: all that it has the weights of), then with the laboratory's.
define try_wheel
	$(1) -m venv $(2) && \
	  $(2)/bin/python $(INSTALL) $(WHEEL)/segloc-*.whl && \
	  $(2)/bin/segloc --version && $(2)/bin/python tests/wheel_smoke.py $(3) && \
	  $(2)/bin/python $(INSTALL) --no-deps $(WHEEL)/segloc_lab-*.whl $(WHEEL)/segloc_stems-*.whl && \
	  $(2)/bin/segloc bench --help > /dev/null && $(2)/bin/segloc stems map --help > /dev/null && $(2)/bin/segloc evaluate roc --help > /dev/null && \
	  $(2)/bin/python tests/wheel_smoke.py $(4)
endef

# The kernels compiled for aarch64, Windows and macOS, and run where an emulator is at hand.
cross-check: ## Compile the kernels for aarch64, Windows and macOS.
	.ci/cross

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# One stamp for each set of extras; an editable install, so only native sources call for a new one.
NATIVE := $(shell find cpp -name '*.cpp' -o -name '*.h') CMakeLists.txt pyproject.toml constraints.txt
$(VENV)/.%: $(NATIVE) | $(BIN)/python
	$(PIP) -e ".[$*]"
	@touch $@

# The laboratory and the plug-in of stems are distributions of their own, which add verbs to segloc.
LABORATORY := $(NATIVE) lab/pyproject.toml plugins/segloc-stems/pyproject.toml
$(VENV)/.evaluate: $(LABORATORY) | $(BIN)/python
	$(PIP) -e ".[io]" -e ./lab -e ./plugins/segloc-stems
	@touch $@

$(VENV)/.test $(VENV)/.dev: $(VENV)/.%: $(LABORATORY) | $(BIN)/python
	$(PIP) -e ".[$*]" -e ./lab -e ./plugins/segloc-stems
	@touch $@

clean: ## Remove build folders and the environment.
	rm -rf build $(VENV)
