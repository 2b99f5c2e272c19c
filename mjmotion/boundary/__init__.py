"""Where files and words come in: what is too large, damaged or lying is refused here, by name.

| module | what it does |
|---|---|
| limits | every bound by name, and checks of numbers against them |
| files | plain files of a bounded size: no pipes, no devices |
| words | text from outside, made harmless for terminals and pages |
| structured | JSON and YAML: no duplicate keys, no bombs, no depth |
| arrays | NumPy archives and arrays, judged by their headers before they are unpacked |
| mjcf | MJCF, judged before MuJoCo compiles it, and the compiled model |
| quiet | warnings of MuJoCo and NumPy, gathered |
"""
