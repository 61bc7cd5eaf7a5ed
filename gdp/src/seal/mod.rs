//! Sealing, segmentation, reassembly.
