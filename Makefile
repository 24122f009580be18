PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint clean

demo: $(VENV)/.demo
	$(BIN)/segloc demo --out demo

test: $(VENV)/.test
	$(BIN)/python -m pytest

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

SOURCES := $(wildcard cpp/*) CMakeLists.txt pyproject.toml constraints.txt

# One stamp for each set of extras; an editable install, so only native sources call for a new one.
$(VENV)/.%: $(BIN)/python $(SOURCES)
	$(PIP) -e ".[$*]"
	@touch $@

clean:
	rm -rf build $(VENV)
