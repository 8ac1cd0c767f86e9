"""The mixed shape space S_m: parts by their rest-space vertices and poses, joints by lengths and angles."""
