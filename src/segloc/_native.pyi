import numpy as np
from numpy.typing import NDArray

__version__: str

def resolve_threads(threads: int) -> int: ...
def lzf_decompress(data: NDArray[np.uint8], size: int) -> NDArray[np.uint8]: ...
