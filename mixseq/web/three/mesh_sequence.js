// A plugin for GLTFLoader of three.js: meshes with the glTF extension MIXSEQ_mesh_sequence play their sequence.
//
//   import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
//   const loader = new GLTFLoader();
//   loader.register((parser) => new MeshSequencePlugin(parser));
//   const { scene } = await loader.loadAsync("shot.glb"), shots = meshSequences(scene);
//   ... each frame: for (const shot of shots) shot.update(seconds % shot.duration);
import { BufferAttribute, BufferGeometry, GLBufferAttribute, Mesh, MeshStandardMaterial } from "three";
import { checkVersion, fieldTextures, openDecoded, takeNormals, takePositions } from "./mixseq.js";

const NAME = "MIXSEQ_mesh_sequence", DRACO = "KHR_draco_mesh_compression";

/** Loads meshes with the extension as `MeshSequence`, and all others unchanged. */
export class MeshSequencePlugin {
  constructor(parser) {
    this.name = NAME;
    this.parser = parser;
    // The static mesh is not loaded, so a Draco decoder, without which GLTFLoader refuses the file, is not needed for it.
    const { json } = parser, others = (json.meshes ?? []).filter((mesh) => !mesh.extensions?.[NAME]);
    if (!others.some((mesh) => mesh.primitives.some(({ extensions }) => extensions?.[DRACO]))) {
      json.extensionsUsed = json.extensionsUsed?.filter((name) => name !== DRACO);
    }
  }

  /** Called by GLTFLoader. */
  loadMesh(number) {
    const mesh = this.parser.json.meshes[number], extension = mesh.extensions?.[NAME];
    return extension ? this.#load(mesh, extension) : null;
  }

  async #load({ name = "", primitives }, extension) {
    checkVersion(extension);
    const { coding, streams, polygons } = extension;
    const bytes = async (view) => new Uint8Array(await this.parser.getDependency("bufferView", view));
    const materials = primitives.map(({ material }) => (material === undefined ? null : this.parser.getDependency("material", material)));
    const [text, data] = await Promise.all([coding, streams].map(bytes));
    const { sequence, drawn } = await openDecoded(new TextDecoder().decode(text), data); // by a Worker
    const painted = (await Promise.all(materials)).map((material) => paintedBy(material, drawn.colours !== null));
    const mesh = new MeshSequence(sequence, drawn, painted, polygons);
    mesh.name = this.parser.createUniqueName(name || "sequence");
    return mesh;
  }
}

/** A material, by default a plain one, whose colour is multiplied by vertex colours, if there are any. */
function paintedBy(material, vertexColors) {
  if (!material) return new MeshStandardMaterial({ color: vertexColors ? 0xffffff : 0xd8d0c4, roughness: 0.8, vertexColors });
  return vertexColors ? Object.assign(material.clone(), { vertexColors }) : material; // others may share it
}

/** The mesh sequences in an object and all below it. */
export function meshSequences(object) {
  const found = [];
  object.traverse((each) => {
    if (each instanceof MeshSequence) found.push(each);
  });
  return found;
}

/** A mesh with the shape of a time. `polygons` are runs of polygons: material and number of each run. */
export class MeshSequence extends Mesh {
  #card = null;
  #renderer = null;

  constructor(sequence, drawn, materials, polygons = [0, sequence?.polygonCount]) {
    super(); // `clone` calls this with nothing, then `copy`
    if (sequence) this.#begin(sequence, drawn, materials, polygons);
  }

  #begin(sequence, drawn, materials, polygons) {
    const { triangles, vertices, uvs, colours } = drawn, { geometry } = this, { counts } = sequence.polygons();
    Object.assign(this, { sequence, drawn, polygons, material: materials.length > 1 ? materials : materials[0] });
    this.isMeshSequence = true;
    this.frustumCulled = false; // the shape may be anywhere
    geometry.setIndex(new BufferAttribute(triangles, 1));
    for (const name of ["position", "normal"]) geometry.setAttribute(name, new BufferAttribute(new Float32Array(3 * vertices.length), 3));
    if (uvs) geometry.setAttribute("uv", new BufferAttribute(uvs, 2));
    if (colours) geometry.setAttribute("color", new BufferAttribute(colours, 4));
    for (let run = 0, polygon = 0, start = 0; run < polygons.length && materials.length > 1; run += 2) {
      const first = start;
      for (const end = polygon + polygons[run + 1]; polygon < end; polygon++) start += 3 * Math.max(counts[polygon] - 2, 0);
      geometry.addGroup(first, start - first, polygons[run]);
    }
    this.update(0);
    geometry.computeBoundingSphere();
  }

  copy(source, recursive) {
    super.copy(source, recursive);
    if (source.sequence) {
      this.geometry = new BufferGeometry(); // its own, so that it may show another time
      this.#begin(source.sequence, source.drawn, [source.material].flat(), source.polygons);
    }
    return this;
  }

  /** Seconds from the first frame to the last. */
  get duration() {
    const { times } = this.sequence;
    return times[times.length - 1] - times[0];
  }

  /**
   * Set the shape of a time in seconds from the first frame, clamped to the first and last frame. With a renderer, its graphics
   * card evaluates the shape; then `geometry` has no positions in memory.
   */
  update(seconds, renderer = null) {
    const { sequence, geometry, drawn } = this, time = sequence.times[0] + seconds;
    if (renderer) {
      if (this.#renderer !== renderer) this.#useCard(renderer);
      this.#card.evaluate(sequence.weights(time), sequence.residuals(time));
      renderer.resetState();
    } else {
      if (this.#renderer) throw new Error("this mesh is on the graphics card; give update its renderer, too");
      const { position, normal } = geometry.attributes;
      takePositions(sequence.at(time), drawn.vertices, position.array);
      takeNormals(position.array, drawn.triangles, drawn.groups, normal.array);
      position.needsUpdate = normal.needsUpdate = true;
    }
    return this;
  }

  #useCard(renderer) {
    const gl = renderer.getContext(), { triangles, vertices, groups } = this.drawn, { geometry } = this;
    this.#renderer = renderer;
    this.#card = fieldTextures(gl, this.sequence.fields(), triangles, vertices, groups);
    geometry.setAttribute("position", new GLBufferAttribute(this.#card.positions, gl.FLOAT, 4, 4, this.#card.count));
    geometry.setAttribute("normal", new GLBufferAttribute(this.#card.normals, gl.FLOAT, 3, 4, this.#card.count));
    renderer.resetState();
  }
}
