# Each rule's needs come first; `make setup` does nothing until pyproject.toml or constraints.txt change.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: setup demo test notebooks lint clean

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

notebooks: setup
	$(BIN)/python -m pytest --nbmake notebooks

lint: setup
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

clean:
	rm -rf .venv build dist runs .pytest_cache .ruff_cache .hypothesis src/*.egg-info
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
