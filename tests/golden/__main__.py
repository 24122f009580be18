"""``python -m golden [GROUP...] [--accept]``"""

from .comparing import main

if __name__ == "__main__":
    main()
