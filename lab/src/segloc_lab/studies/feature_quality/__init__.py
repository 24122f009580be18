"""FC4, the paper's feature quality: trained in several ways on several surroundings, compared."""
