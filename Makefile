# GTSAM has no wheel for Python 3.10, as of ROS 2 Humble: make PYTHON=python3.12, in whose venv no ROS is needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: run test test-all interop coverage notebooks check mutants kernels bench evidence guard pictures pictures-check docs clean
.DEFAULT_GOAL := run

PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

# One stamp per pyproject.toml: a changed dependency installs again, nothing else does.
$(VENV)/package: pyproject.toml
	@echo "make: creating $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@echo "make: installing the package and what a run needs, about 800 MB; pip says nothing for some minutes"
	@$(PIP) --editable .
	@touch $@

$(VENV)/installed: $(VENV)/package
	@echo "make: installing what tests and documentation need besides, about 400 MB; pip says nothing for some minutes"
	@$(PIP) --editable ".[dev,docs]"
	@touch $@

run: $(VENV)/package  ## see a robot explore an apartment
	@echo "make: $(BIN)/sixthsense run apartment --out runs/first --overwrite"
	@$(BIN)/sixthsense run apartment --out runs/first --overwrite

test: $(VENV)/installed kernels  ## what CI runs
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist worksteal

test-all: $(VENV)/installed kernels  ## the slow statistics too
	$(BIN)/python -m pytest -n 2 --dist worksteal

interop: $(VENV)/installed kernels  ## live runs with a robot on Fast DDS; Debian: apt-get install libfastrtps-dev fastddsgen g++
	$(BIN)/python -m pytest tests/interop/fast_dds.py -rs -n 0

coverage: $(VENV)/installed kernels  ## which share of the branches of each room the tests take
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist worksteal --cov=sixthsense --cov-branch --cov-report=
	@for room in $(dir $(wildcard sixthsense/*/__init__.py)); do \
		printf '%-26s' "$$room"; $(BIN)/python -m coverage report --include="$$room*" --format=total; done

notebooks: $(VENV)/installed  ## run every notebook, as CI does, longer cells cut short; none is rewritten
	SIXTHSENSE_LONG=0 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --nbmake --nbmake-timeout=120 -n 2 notebooks

kernels: $(VENV)/installed  ## compile the Numba kernels, which several processes then share
	@$(BIN)/python -c "from sixthsense.running.warmup import warm_up; warm_up()" & \
		$(BIN)/python -c "from sixthsense.running.warmup import warm_up; warm_up('scan-matching')"; wait

check: $(VENV)/installed  ## style, types, imports, structure and budget of code lines
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -q -n 0 tests/test_house.py

mutants: $(VENV)/installed  ## FILE=, a file or a folder of the package: which small wrong changes of it does no test see? SAMPLE=N SEED=S
	$(BIN)/python tests/mutants.py $(FILE) $(if $(SAMPLE),--sample $(SAMPLE)) $(if $(SEED),--seed $(SEED))

bench: $(VENV)/installed kernels  ## speed of the hot loops beside peers and limits; 2 minutes
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/suite.py speed

evidence: $(VENV)/installed kernels  ## rows that another package has measured, the oldest first, for 10 minutes; CASES=houses: these cases
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/suite.py --budget 10 $(CASES)

guard: $(VENV)/installed kernels  ## has a headline figure become worse than its spread explains?
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/suite.py --check $(CASES)

pictures: $(VENV)/installed kernels  ## all pictures and films of README, site and gallery, and the notebooks; docs/pictures.toml
	$(BIN)/python docs/pictures.py

pictures-check: $(VENV)/installed kernels  ## which of them look otherwise today? Before a release
	$(BIN)/python docs/pictures.py --check

docs: $(VENV)/installed  ## site/index.html; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

clean:
	rm -rf $(VENV) runs site
