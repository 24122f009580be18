"""What tests are made of: small scenes, recordings in every format, the real scans."""
