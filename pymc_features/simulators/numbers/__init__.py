"""Numbers in the registers of the processor, and numbers made of them."""
