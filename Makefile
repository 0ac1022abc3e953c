# Each rule's needs come first; `make setup` does nothing until pyproject.toml or constraints.txt change.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
QUICK := JAX_DISABLE_MOST_OPTIMIZATIONS=1 XLA_FLAGS=--xla_cpu_use_fusion_emitters=false
LOWEST := import tomllib; needs = tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]; \
    print(*(need.replace(">=", "==") for need in needs), sep="\n")

.PHONY: setup demo test notebooks docs lint smoke smoke-pinned smoke-newest smoke-lowest clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "jaxtissue needs Python 3.11 or newer; run: make setup PYTHON=python3.11" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet -c constraints.txt pip
	$(BIN)/python -m pip install --quiet -c constraints.txt --build-constraint constraints.txt -e '.[dev]'
	@touch $@

demo: setup
	$(BIN)/jaxtissue anneal --apical-radius 1 --out runs/demo-ra1 --force
	$(BIN)/jaxtissue anneal --apical-radius 5 --out runs/demo-ra5 --force

test: setup
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile

# the pairs of notebooks, *.py, are left out: looked through for examples, they would run as well
notebooks: setup
	PATH="$(CURDIR)/$(BIN):$$PATH" $(QUICK) $(BIN)/python -m pytest --nbmake notebooks/*.ipynb

docs: setup
	$(BIN)/python -m sphinx -q -W --keep-going -c docs -d build/doctrees . build/site
	@echo "the site is build/site/index.html"

lint: setup
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

# the newest and the lowest versions that pyproject.toml allows compute what the pinned ones do; `make -j2 smoke`
smoke: smoke-newest smoke-lowest

smoke-pinned: setup
	$(BIN)/python tests/smoke.py .venv/smoke.json

smoke-newest smoke-lowest: smoke-%: .venv-%/.installed smoke-pinned
	.venv-$*/bin/python tests/smoke.py .venv-$*/smoke.json .venv/smoke.json

.venv-newest/.installed: pyproject.toml
	python=$$(.ci/find-python 14 13 12 11) && $$python -m venv --clear .venv-newest
	.venv-newest/bin/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

.venv-lowest/.installed: pyproject.toml
	python=$$(.ci/find-python 11) && $$python -m venv --clear .venv-lowest
	.venv-lowest/bin/python -c '$(LOWEST)' > .venv-lowest/constraints.txt
	.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check -c .venv-lowest/constraints.txt -e .
	@touch $@

clean:
	rm -rf .venv .venv-newest .venv-lowest build dist runs .pytest_cache .ruff_cache .hypothesis src/*.egg-info
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
