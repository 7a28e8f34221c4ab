# Everything runs from here; only make and python3 (3.11 or newer) are needed. GNU make 3.81, as macOS has it, is enough.

PYTHON = python3
IN_VENV = .venv/bin/python

# Results must not depend on how the user's Python, IPython and matplotlib are set up. MPLBACKEND would switch off the figures of notebooks.
unexport PYTHONPATH
unexport MPLBACKEND
export IPYTHONDIR := $(CURDIR)/.venv/ipython
export MPLCONFIGDIR := $(CURDIR)/.venv/matplotlib

# Two notebooks or tests run at a time, and studies in as many processes as there are cores: threads of the linear algebra would only wait for one another.
export OMP_NUM_THREADS ?= 1

# Tests run in two processes, each file in one of them.
TOGETHER = -n 2 --dist loadfile

PACKAGES = .venv/packages.stamp
ENVIRONMENT = .venv/environment.stamp

NOTEBOOKS := $(sort $(basename $(notdir $(wildcard notebooks/*.ipynb))))
STAMPS := $(NOTEBOOKS:%=build/notebooks/%.stamp)
SOURCES := $(foreach package,analysis studies,$(wildcard src/$(package)/*.py src/$(package)/*/*.py src/$(package)/*/*/*.py)) $(wildcard data/published/*.csv)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help environment reproduce notebooks test compare bench lock lab report scans readme clean

help: ## list the commands
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/\1|\2/p' Makefile | awk -F '|' '{ printf "make %-12s %s\n", $$1, $$2 }'

environment: $(ENVIRONMENT) ## make .venv from environment.txt

# The stamps lie inside .venv and are written last: an interrupted build has none, and the next one starts from an empty .venv.
$(PACKAGES): environment.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed, and $(PYTHON) is " + sys.version.split()[0] + ". To use another: make PYTHON=python3.12 ...")'
	@echo "Making .venv from environment.txt: about 130 MB to download, then half a minute"
	@$(PYTHON) -m venv --clear .venv
	@$(IN_VENV) -m pip install --quiet --quiet --disable-pip-version-check --require-hashes -r environment.txt
	@touch $@

# Without dependencies and build isolation, so that only locked packages are ever installed. Importing the font manager makes matplotlib's
# font cache now: made inside a notebook, it would write a notice to its output.
$(ENVIRONMENT): $(PACKAGES) pyproject.toml
	@$(IN_VENV) -m pip install --quiet --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@$(IN_VENV) -c 'import matplotlib.font_manager'
	@touch $@

reproduce: $(ENVIRONMENT) ## run the notebooks whose inputs changed (in a fresh clone: all), show the headline table and what agrees
	@$(IN_VENV) -m project.scans --needed || true
	@$(MAKE) --no-print-directory -j 2 notebooks
	@$(IN_VENV) -m project.readme --show headline
	@$(IN_VENV) -m project.agreement

notebooks: $(STAMPS)
	@echo "The notebooks are up to date."

build/notebooks/%.stamp: notebooks/%.ipynb $(SOURCES) $(PACKAGES) | $(ENVIRONMENT)
	@$(IN_VENV) -m project.notebooks run $*
	@mkdir -p $(@D) && touch $@

# The last notebook reads what the others wrote; these do not need one another.
LAST := $(lastword $(STAMPS))
$(LAST): $(filter-out $(LAST),$(STAMPS))

build/notebooks/05_real_spheres.stamp: $(wildcard data/scans/*.xyz)

test: $(ENVIRONMENT) ## style and types; unit tests and doctests; then every notebook run again and compared with its stored output and tables
	@$(IN_VENV) -m ruff check --quiet
	@$(IN_VENV) -m ruff format --check --quiet
	@$(IN_VENV) -m mypy
	@$(IN_VENV) -m pytest $(TOGETHER)
	@$(MAKE) --no-print-directory compare

compare: $(ENVIRONMENT)
	@export ANALYSIS_OUTPUT="$$(mktemp -d)" && trap 'rm -rf "$$ANALYSIS_OUTPUT"' EXIT && \
	  $(IN_VENV) -m pytest $(TOGETHER) --nbval --nbval-current-env notebooks && \
	  $(IN_VENV) -m pytest tests/project/test_results.py

bench: $(ENVIRONMENT) ## time and memory of every method, beside another library's
	@$(IN_VENV) -m project.bench
	@$(IN_VENV) -m project.tunnel_bench

lab: $(ENVIRONMENT) ## open the notebooks in JupyterLab
	@$(IN_VENV) -m jupyterlab --notebook-dir=notebooks

report: $(ENVIRONMENT) ## the notebooks as a static site in build/site
	@$(IN_VENV) -m project.site

scans: $(ENVIRONMENT) ## fetch the real scans into data/scans; SCANS_FROM=folder takes them from a folder
	@$(IN_VENV) -m project.scans $(if $(SCANS_FROM),--from "$(SCANS_FROM)")

readme: $(ENVIRONMENT) ## renew the generated sections of the README
	@$(IN_VENV) -m project.readme

lock: ## renew environment.txt from environment.in; what still fits keeps its version, unless environment.txt is removed first
	@$(PYTHON) -m venv --clear build/lock
	@build/lock/bin/python -m pip install --quiet --quiet --disable-pip-version-check uv
	@build/lock/bin/uv pip compile --quiet --system-certs --universal --python-version 3.11 --generate-hashes \
	  --custom-compile-command "make lock" --output-file environment.txt environment.in
	@rm -r build/lock

clean: ## remove build/ and caches (the environment stays; to make it anew, remove .venv)
	@rm -rf build .pytest_cache .ruff_cache .mypy_cache
	@find src tests notebooks \( -name __pycache__ -o -name .ipynb_checkpoints -o -name '*.egg-info' \) -prune -exec rm -r {} +
