"""How results are shown: tables, texts, HTML, pictures. No module here knows an instrument."""
