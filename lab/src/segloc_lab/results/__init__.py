"""Results that are kept with what produced them, and the pages that are generated from them."""
