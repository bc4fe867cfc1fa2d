// Sibling of shade.rs, whose head says what the terms are.

struct Terms {
    diffuse: vec3<f32>,
    ambient: vec3<f32>,
    emissive: vec3<f32>,
    f0: vec3<f32>,
    f90: f32,
    exponent: f32,
    mirror: vec3<f32>,
    passed: vec3<f32>,
    /// How glass passes the ray: straight on unless `is_bent`.
    is_bent: bool,
    bent: vec3<f32>,
}

const MAX_EXPONENT: f32 = 1024.0;
const EIGHT_PI: f32 = 25.1327419;

fn terms_of(paint: Paint, surface: Surface, direction: vec3<f32>) -> Terms {
    let none = vec3<f32>(0.0);
    // Show an unlit colour as it is.
    if paint.unlit { return Terms(none, none, paint.base, none, 0.0, 0.0, none, none, false, none); }

    // Split the surface into glass and body, and the reflection into mirror and lobe.
    let transmission = select(0.0, paint.transmission, HAS_GLASS && has_feature(FEATURE_REFRACTION));
    let glass = glass_share(paint);
    let smoothness = max(1.0 - 2.0 * paint.roughness, 0.0);
    let gloss = select(0.0, smoothness * smoothness, HAS_MIRRORS && has_feature(FEATURE_REFLECTION));
    let body_color = times(1.0 - paint.metallic, 1.0 - transmission) + times(paint.metallic, 1.0 - gloss);
    let diffuse = scaled(paint.base, body_color);

    // Find the reflectance.
    let r = quotient(paint.ior - 1.0, paint.ior + 1.0);
    let dielectric = mixed(paint.specular, vec3<f32>(times(r, r)), transmission);
    let f0 = mixed(dielectric, paint.base, paint.metallic);
    let f90 = min(50.0 * max_element(f0), 1.0);
    let fresnel = schlick(f0, f90, -dot3(direction, surface.shading));

    // Weigh the traced rays.
    var mirror = scaled(fresnel, times(1.0 - glass, gloss));
    var passed = none;
    var passage = Passage(false, none, 0.0);
    if HAS_GLASS && glass > 0.0 {
        passage = pass_glass(paint, surface, direction);
        let inside = !surface.from_front && !paint.thin_walled;
        let sharp = select(gloss, 1.0, inside && has_feature(FEATURE_REFLECTION));
        mirror += vec3<f32>(times(times(glass, passage.reflectance), sharp));

        // Without reflection all of it passes, but for what can't: total reflection bends no ray.
        let kept = select(0.0, passage.reflectance, has_feature(FEATURE_REFLECTION) || passage.reflectance == 1.0);
        passed = scaled(paint.base, times(glass, 1.0 - kept));
    }
    return Terms(
        diffuse, times3(diffuse, vec3<f32>(1.0) - scaled(fresnel, gloss)), paint.emissive, f0, f90,
        highlight_exponent(paint.roughness), mirror, passed, passage.is_bent, passage.bent,
    );
}

/// The share of a surface that refracts.
fn glass_share(paint: Paint) -> f32 {
    if !HAS_GLASS { return 0.0; }
    return select(0.0, times(paint.transmission, 1.0 - paint.metallic), has_feature(FEATURE_REFRACTION) && !paint.unlit);
}

struct Passage {
    is_bent: bool,
    bent: vec3<f32>,
    reflectance: f32,
}

/// How glass passes a ray, and how much it reflects instead.
fn pass_glass(paint: Paint, surface: Surface, direction: vec3<f32>) -> Passage {
    // Equal media neither bend nor reflect.
    if paint.ior == 1.0 { return Passage(false, direction, 0.0); }

    // A thin wall reflects like the outside of a body and does not bend.
    let entering = surface.from_front || paint.thin_walled;
    let eta = select(paint.ior, quotient(1.0, paint.ior), entering);
    let refracted = refract_at(direction, surface.shading, eta);
    let is_bent = refracted.is_bent && !paint.thin_walled;
    return Passage(is_bent, onto_side(refracted.bent, -surface.facing), refracted.reflectance);
}

/// Direction and exact Fresnel reflectance; not bent, and all of it reflected, when totally so.
fn refract_at(direction: vec3<f32>, normal: vec3<f32>, eta: f32) -> Passage {
    // Find the cosine on the other side by Snell's law; 0 at the critical angle itself.
    let cos_in = clamp(-dot3(direction, normal), 0.0, 1.0);
    let k = 1.0 - times(times(eta, eta), 1.0 - times(cos_in, cos_in));
    if !(k >= 0.0) { return Passage(false, direction, 1.0); }
    let cos_out = root(k);

    // Average the reflectances of both polarisations.
    let eta_in = times(eta, cos_in);
    let eta_out = times(eta, cos_out);
    let across = quotient(eta_in - cos_out, eta_in + cos_out);
    let along = quotient(cos_in - eta_out, cos_in + eta_out);
    let reflectance = 0.5 * (times(across, across) + times(along, along));
    let bent = scaled(direction, eta) + scaled(normal, eta_in - cos_out);
    return Passage(true, normalized_or(bent, direction), select(1.0, reflectance, reflectance <= 1.0));
}

/// The mirror ray's direction: never under the surface.
fn reflect_at(direction: vec3<f32>, surface: Surface) -> vec3<f32> {
    let mirrored = direction - scaled(surface.shading, 2.0 * dot3(direction, surface.shading));
    return onto_side(normalized(mirrored), surface.facing);
}

fn onto_side(direction: vec3<f32>, side: vec3<f32>) -> vec3<f32> {
    let height = dot3(direction, side);
    if height < 0.0 { return direction - scaled(side, 2.0 * height); }
    return direction;
}

/// Schlick's reflectance at the angle whose cosine is `cosine`.
fn schlick(f0: vec3<f32>, f90: f32, cosine: f32) -> vec3<f32> {
    let x = clamp(1.0 - cosine, 0.0, 1.0);
    let x2 = x * x;
    return f0 + scaled(vec3<f32>(f90) - f0, x2 * x2 * x);
}

fn highlight_exponent(roughness: f32) -> f32 {
    let width = roughness * roughness;
    let squared = width * width;
    // Below the exponent's bound the quotient is finite.
    if squared <= 2.0 / (MAX_EXPONENT + 2.0) * 0.5 { return MAX_EXPONENT; }
    return clamp(quotient(2.0, squared) - 2.0, 0.0, MAX_EXPONENT);
}

/// Normalised Blinn-Phong.
fn highlight(cosine: f32, exponent: f32) -> f32 {
    let scale = quotient((exponent + 2.0) * (exponent + 4.0), EIGHT_PI * (exp2_nonpositive(-0.5 * exponent) + exponent));
    return scale * pow_unit(max(cosine, 0.0), exponent);
}

/// Share of the light from `to_light` that goes to the viewer.
fn reflected(terms: Terms, surface: Surface, to_light: vec3<f32>, direction: vec3<f32>) -> vec3<f32> {
    let halfway = normalized_or(to_light - direction, surface.shading);
    let fresnel = schlick(terms.f0, terms.f90, -dot3(halfway, direction));
    var lobe = 0.0;
    if terms.f90 > 0.0 { lobe = highlight(dot3(halfway, surface.shading), terms.exponent); }
    return scaled(times3(terms.diffuse, vec3<f32>(1.0) - fresnel), FRAC_1_PI) + scaled(fresnel, lobe);
}
