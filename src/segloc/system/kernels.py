"""Native kernels for training, peers and benchmarks, by public names."""

from .._native import DescriptorIndex as DescriptorIndex
from .._native import Network as Network
from .._native import PointIndex as PointIndex
from .._native import Surface as Surface
from .._native import VoxelNetwork as VoxelNetwork
from .._native import column_maps as column_maps
from .._native import column_maps_backward as column_maps_backward
from .._native import consensus as consensus
from .._native import dilated_neighbors as dilated_neighbors
from .._native import elu_norm as elu_norm
from .._native import elu_norm_backward as elu_norm_backward
from .._native import euclidean_clusters as euclidean_clusters
from .._native import fps as fps
from .._native import heights_above_ground as heights_above_ground
from .._native import instruction_set as instruction_set
from .._native import knn as knn
from .._native import pair_features as pair_features
from .._native import prepare_segments as prepare_segments
from .._native import prosac as prosac
from .._native import voxel_grid as voxel_grid
from .._native import xconv_apply as xconv_apply
from .._native import xconv_apply_backward as xconv_apply_backward
