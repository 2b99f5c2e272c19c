# make demo and make test are all that a fresh machine needs; both set up .venv first.
SHELL := /bin/bash
PYTHON ?= python3
export PYTHON
# APT=1 lets make install system packages, as root on Debian; else it only says which.
export APT
BIN := .venv/bin
READY := .venv/ready

.DEFAULT_GOAL := help
.PHONY: help setup demo gallery test lint bench scenes fuzz kills lock clean

help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):[^#]*## /\1\t/' | expand -t 10

setup: $(READY) ## make .venv with the pinned packages and mjmotion

$(READY): requirements.lock pyproject.toml .ci/setup
	@.ci/setup
	@touch $@

demo: $(READY) ## adapt the built-in walk to rough terrain with doorways: report and video
	@.ci/opengl || true
	@$(BIN)/mjmotion demo --out out/demo --force

gallery: $(READY) ## the paper's figures: videos and a page of stills in out/gallery
	@.ci/opengl || true
	@$(BIN)/python scripts/gallery.py --out out/gallery

test: lint ## set up, lint, type check, and run all tests
	@.ci/opengl || true
	@.ci/browser || true
	$(BIN)/python -m pytest --numprocesses=auto --dist=loadfile --durations=10

lint: $(READY) ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY) ## the project's figures beside their targets, written to docs/results.md
	$(BIN)/python scripts/benchmark.py --write

scenes: $(READY) ## write the scenes of scenes/ anew
	$(BIN)/python scripts/make_scenes.py

fuzz: $(READY) ## 10,000 damaged inputs through every reader; CASES=N for another number
	$(BIN)/python tests/fuzz/fuzz_all.py --cases $(or $(CASES),10000)

kills: $(READY) ## 200 kills at random moments of all that writes; KILLS=N for another number
	$(BIN)/python tests/kills.py --kills $(or $(KILLS),200)

lock: ## write requirements.lock anew with the newest packages
	.ci/lock

clean: ## remove everything that was made here
	rm -rf .venv out dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
