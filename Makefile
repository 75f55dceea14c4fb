# make demo    the whole chain on the default study, from a fresh clone to its report
# make test    ruff and the test suite
# make bench   speed and memory against their targets
# make docs    the generated pages of docs/
# make venv    only the installation, in .venv
# make lock    write requirements.lock again, after changing requirements.txt

PYTHON ?= $(shell command -v python3.11 || command -v python3)
CORES ?= 2

export PATH := $(CURDIR)/.venv/bin:$(PATH)
INSTALLED := .venv/.installed
SOURCES := acgd benchmarks examples tests docs/images setup.py

.PHONY: demo test bench docs venv lock system

demo: venv
	snakemake --cores $(CORES) all
	@echo "The report: $(CURDIR)/results/$$(python -c 'import yaml; print(yaml.safe_load(open("config.yaml"))["name"])')/report.html"

test: venv
	ruff check $(SOURCES)
	ruff format --check $(SOURCES)
	python -m pytest tests

bench: venv
	python -m benchmarks.table

docs: venv
	python -m acgd schema

venv: system $(INSTALLED)

system:
	@sh scripts/system-packages.sh "$(PYTHON)"

# torch on a line of its own: beside others pip may settle on a newer one first.
$(INSTALLED): requirements.txt requirements.lock | system
	"$(PYTHON)" -m venv .venv
	python -m pip install --quiet --constraint requirements.lock pip
	python -m pip install --constraint requirements.lock torch
	python -m pip install --constraint requirements.lock --requirement requirements.txt
	touch $@

lock: venv
	python -m pip install --upgrade --requirement requirements.txt
	{ echo "# Every package of a working installation (Python 3.11, Linux), written by \`make lock\`."; \
	  python -m pip freeze --all | sed 's/+cpu$$//'; } > requirements.lock
