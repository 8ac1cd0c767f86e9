"""Print constraints for pip: the oldest versions that pyproject.toml allows of what users install, extras included."""

import re
import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
extras = project["optional-dependencies"]
of_users = re.findall(r"\w+", extras["all"][0])[1:]  # mixseq[alembic,dask,...]
for requirement in [*project["dependencies"], *(each for name in of_users for each in extras[name])]:
    print(re.sub(r">=([^,]+).*", r"==\1", requirement))
