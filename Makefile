# GTSAM has no wheel for Python 3.10, as of ROS 2 Humble: make PYTHON=python3.12, in whose venv no ROS is needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RELEASE := build/release

.PHONY: run test test-all interop coverage notebooks check mutants kernels bench evidence guard pictures pictures-check docs release-check clean
.DEFAULT_GOAL := run

# Python compiles what it imports; compiled by pip, all modules take 150 MB more.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile

# One stamp per pyproject.toml: a changed dependency installs again, nothing else does.
$(VENV)/package: pyproject.toml
	@echo "make: creating $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@echo "make: installing the package and what a run needs, about 700 MB; pip says nothing for some minutes"
	@$(PIP) --editable .
	@touch $@

$(VENV)/installed: $(VENV)/package
	@echo "make: installing what tests and documentation need besides, about 350 MB; pip says nothing for some minutes"
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

# Away from the checkout, whose package and scenes would else be found.
release-check:  ## build the wheel, install it in an empty environment, run README's lines of Python and commands there
	rm -rf $(RELEASE)
	$(PYTHON) -m venv $(RELEASE)/venv
	$(RELEASE)/venv/bin/python -m pip wheel --quiet --no-deps --wheel-dir $(RELEASE) .
	$(RELEASE)/venv/bin/python -m pip install --quiet $(RELEASE)/*.whl
	sed -n '/^```python$$/,/^```$$/{/^```/!p}' README.md > $(RELEASE)/readme.py
	cd $(RELEASE) && venv/bin/python readme.py && test -s map.png
	cd $(RELEASE) && venv/bin/sixthsense run apartment --out runs/first && test -s runs/first/map.png
	$(RELEASE)/venv/bin/python -m pip install --quiet pytest hypothesis
	$(RELEASE)/venv/bin/pytest tests/core tests/config

clean:
	rm -rf $(VENV) $(RELEASE) runs site
