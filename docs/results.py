"""Fill the tables of the documentation from the results that are stored in docs/results.

python docs/results.py            # writes the tables, and says which are outdated
python docs/results.py --check    # exit status 1 where a page is not as its results are stored
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "experiments" / "src"))

from segloc_lab.results.pages import main

if __name__ == "__main__":
    main()
