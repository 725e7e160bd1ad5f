"""What a render leaves behind: EXR and PNG pictures and the statistics file, each of which appears whole or not at all."""
