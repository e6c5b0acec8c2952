"""The paper's model (section 3.4 and appendix B): encoder, U-Net and generation."""
